"""Which files does cloud-init read at the first boot? ``user-data``, ``network-config`` and ``meta-data`` (NoCloud).

The keys are those of cloud-init's own schema (https://docs.cloud-init.io/en/latest/reference/modules.html), and of its
network configuration version 2, which is netplan's. Raspberry Pi OS reads the same since trixie; its own additional keys
are not used, because other systems refuse them.
"""

from __future__ import annotations

import hashlib
import re
from typing import TYPE_CHECKING, Any

from fleet.card.first_boot import MARK, HostKey
from fleet.config import yamlfile
from fleet.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from fleet.card.first_boot import FirstBoot

USER_DATA, NETWORK, META_DATA = "user-data", "network-config", "meta-data"
_INSTANCE = re.compile(r"(?<!\S)(ds=nocloud(?:-net)?;(?:[^\s;]+;)*?(?:i|instance-id)=)[^\s;]*")
"""The kernel's parameter that says which instance this is. The Raspberry Pi Imager writes it, and it goes before
``meta-data`` (https://docs.cloud-init.io/en/latest/reference/datasources/nocloud.html)."""

_FOLDER = "/boot/firmware"
"""Where Raspberry Pi OS and Ubuntu have the boot partition."""

_GROUPS = (
    *("adm", "dialout", "cdrom", "audio", "users", "sudo", "video", "games", "plugdev", "input"),
    *("gpio", "spi", "i2c", "netdev", "render"),
)
"""Groups of the first user of Raspberry Pi OS."""

_KEEP_KEY = """\
mkdir -p /etc/systemd/system/regenerate_ssh_host_keys.service.d
printf '[Unit]\\nConditionPathExists=!/etc/ssh/ssh_host_ed25519_key\\n' \
> /etc/systemd/system/regenerate_ssh_host_keys.service.d/fleet.conf
systemctl daemon-reload"""
"""Raspberry Pi OS makes new host keys at its first boot, after cloud-init has written ours. Now it does only without one."""

_FORGET_KEY = f"sed -i '/^ssh_keys:/,$d' {_FOLDER}/{USER_DATA}"
"""The boot partition can be read by everybody on the robot. cloud-init's own copy is root's."""


def files(first: FirstBoot, *, raspberry_pi_os: bool, cmdlines: Mapping[str, str]) -> dict[str, str]:
    """Return the files by name.

    ``cmdlines`` are the card's files with the kernel's parameters, by name. One that says which instance this is becomes one
    of the files, and says ours: otherwise a system that has booted already would not read the others.
    """
    head = f"{MARK}{first.robot}\n"
    user_data = f"#cloud-config\n{head}{yamlfile.dump(_user_data(first, raspberry_pi_os=raspberry_pi_os))}"
    network = head + yamlfile.dump({"network": _network(first)})
    # cloud-init sets a computer up once for each instance: new content is a new instance.
    digest = hashlib.sha256(f"{user_data}{network}".encode()).hexdigest()[:12]
    instance = f"fleet-{first.hostname}-{digest}"
    meta = head + yamlfile.dump({"instance-id": instance, "dsmode": "local"})
    pinned = {
        name: _INSTANCE.sub(lambda match: match[1] + instance, text)
        for name, text in cmdlines.items()
        if _INSTANCE.search(text)
    }
    return {USER_DATA: user_data, NETWORK: network, META_DATA: meta, **pinned}


def host_key(user_data: str, *, path: Path) -> HostKey | None:
    """Return the host key that a card has already."""
    try:
        value = yamlfile.parse(user_data, path=path, error=UsageError)[0].value.get("ssh_keys")
    except UsageError:
        return None
    match value:
        case {"ed25519_private": str(private), "ed25519_public": str(public)}:
            return HostKey(private=private, public=public)
        case _:
            return None


def _user_data(first: FirstBoot, *, raspberry_pi_os: bool) -> Mapping[str, Any]:
    login = {
        "name": first.user,
        "primary_group": first.user,  # without it, a login is not made that has the name of a group, such as operator
        "groups": list(_GROUPS),
        "shell": "/bin/bash",
        "lock_passwd": True,
        "sudo": "ALL=(ALL) NOPASSWD:ALL",
        "ssh_authorized_keys": list(first.keys),
    }
    data: dict[str, Any] = {"hostname": first.hostname, "manage_etc_hosts": True, "users": [login]}
    data |= {"ssh_pwauth": False, "disable_root": True}
    if first.timezone:
        data["timezone"] = first.timezone
    commands: list[list[str]] = []
    if raspberry_pi_os:
        data["bootcmd"] = [["sh", "-c", _KEEP_KEY]]
        commands = [["systemctl", "enable", "--now", "ssh"]]
    elif first.announces:
        data["packages"] = ["avahi-daemon"]  # Raspberry Pi OS has it
    if first.host_key:
        commands = [*commands, ["sh", "-c", _FORGET_KEY]]
        data["ssh_deletekeys"] = True
        keys = {"ed25519_private": first.host_key.private, "ed25519_public": first.host_key.public}
    data["runcmd"] = commands
    # The last key: `_FORGET_KEY` cuts the file there.
    return {**data, "ssh_keys": keys} if first.host_key else data


def _network(first: FirstBoot) -> Mapping[str, Any]:
    cable = {"match": {"name": "e*"}, "dhcp4": True, "optional": True}
    network: dict[str, Any] = {"version": 2, "ethernets": {"cable": cable}}
    if first.networks:
        points = {
            one.name: {
                **({"password": one.key} if one.key else {}),
                **({"hidden": True} if one.hidden else {}),
            }
            for one in first.networks
        }
        wlan = {"dhcp4": True, "regulatory-domain": first.country, "access-points": points}
        network["wifis"] = {"wlan0": wlan}
    return network
