"""A first boot as the tests of the systems that read it share it."""

from __future__ import annotations

from fleet.card.first_boot import FirstBoot, HostKey, Network

KEY = "ab" * 32
FIRST = FirstBoot(
    robot="pi7",
    hostname="pi7",
    user="pi",
    keys=("ssh-ed25519 AAAA me@desktop",),
    host_key=HostKey(
        private="-----BEGIN OPENSSH PRIVATE KEY-----\nabc\n-----END OPENSSH PRIVATE KEY-----\n",
        public="ssh-ed25519 BBBB root@pi7",
    ),
    timezone="Europe/Berlin",
    country="DE",
    networks=(Network(name='Lab: "5 GHz" ß', key=KEY), Network(name="Guests", key="", hidden=True)),
    password="$6$salt$hash",  # noqa: S106  it is none
)
