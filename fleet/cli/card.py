"""Which verb prepares a card? ``fab card``."""

from __future__ import annotations

import getpass
import os
import socket
import zoneinfo
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from fleet.card import cloud_init, custom_toml, first_boot, password, prepared, system, userconf, write
from fleet.card.first_boot import HIDDEN, FirstBoot, HostKey, Network
from fleet.cli import program
from fleet.cli.console import Screen
from fleet.cli.selection import select
from fleet.cli.verb import verb
from fleet.errors import FleetError, UsageError
from fleet.plan.outcome import Outcome, failure
from fleet.ssh import host_keys, known_hosts, openssh_config

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from fleet.card.prepared import Prepared
    from fleet.card.system import System
    from fleet.config import card as values
    from fleet.config.inventory import Robot
    from fleet.plan.outcome import Status
    from fleet.ssh.openssh_config import Destination

_PLACES = ("/media/*/*", "/run/media/*/*", "/media/*", "/mnt/*", "/mnt")


@verb(
    {
        "hosts": "the robot of this card; several: one card after the other",
        "boot": "the folder where the card's boot partition is mounted, such as /media/me/bootfs",
        "password_from": "variable with the login's password, for systems that take no SSH key; default: ask",
        "overwrite": "prepare anew a card that was prepared for another robot, or that its robot has booted from",
    }
)
def card(
    hosts: str = "all",
    boot: str = "",
    password_from: str = "",
    overwrite: bool = False,
    dry: bool = False,
    json: bool = False,
    inventory: str = "",
) -> int:
    """Prepare a robot's freshly written SD card.

    It writes what the first boot needs onto the card's boot partition: name, login with your SSH key, Wi-Fi, time zone, and
    an SSH host key that it records, so that `fab trust` is not needed. Raspberry Pi OS before trixie takes no host key. The
    key `card:` of the inventory has Wi-Fi and time zone. The card tells which system is on it. Until the first boot, a
    second run changes nothing.
    """
    screen, robots = Screen(), select(inventory, hosts)[1]
    if not boot:
        raise UsageError("which card?", cure=_where())
    if len(robots) > 1 and not screen.interactive and not dry:
        raise UsageError(
            f"{len(robots)} robots need {len(robots)} cards, and nobody is here to change them",
            cure="name one robot: fab card --hosts NAME --boot FOLDER",
        )
    desk = _Desk(screen=screen, folder=Path(boot), password_from=password_from, overwrite=overwrite, dry=dry)
    if len(robots) == 1 or dry:
        outcomes = [desk.prepare(robot, show=not json) for robot in robots]
    else:
        outcomes = list(_one_after_the_other(robots, desk))
    code = screen.result(outcomes, json=json)
    if not code and not dry:
        names = ",".join(robot.name for robot in robots)
        text = f"unmount the card before you pull it out; `fab await --hosts {names}` says when the robot has come up"
        screen.say(program.typed(text))
    return code


def _one_after_the_other(robots: Iterable[Robot], desk: _Desk) -> Iterator[Outcome]:
    """Ask for each card, and once more if it is not the right one. Ctrl-C ends it."""
    goes_on = True
    for robot in robots:
        outcome = Outcome(robot=robot.name, status="skipped", reason="interrupted by Ctrl-C")
        while goes_on:
            goes_on = desk.screen.pause(f"Insert the card of {robot.name} and press Enter (Ctrl-C ends)")
            if not goes_on:
                break
            outcome = desk.prepare(robot, show=False)
            if outcome.good:
                desk.screen.say(f"{robot.name}: the card is ready; unmount it and take it out")
                break
            desk.screen.say(f"{robot.name}: {outcome.reason}\n  cure: {outcome.cure}")
        yield outcome


@dataclass(frozen=True, kw_only=True)
class _Desk:
    """Where cards are prepared. ``passphrases`` are those that a person has typed, by network."""

    screen: Screen
    folder: Path
    password_from: str
    overwrite: bool
    dry: bool
    passphrases: dict[str, str] = field(default_factory=dict)

    def prepare(self, robot: Robot, *, show: bool) -> Outcome:
        """Prepare one card, or with ``dry`` show its files."""
        try:
            return self._prepare(robot, show=show)
        except FleetError as problem:
            return failure(robot.name, problem)

    def _prepare(self, robot: Robot, *, show: bool) -> Outcome:
        found = system.look(self.folder)
        there = prepared.look(self.folder)
        if not self.overwrite:
            there.check(robot.name)
        destination = openssh_config.resolve(robot)
        first = self._first_boot(robot, destination, found, there)
        make, lost = _maker(found, self.folder)
        files = make(first)
        if self.dry:
            states = write.planned(files, folder=self.folder)
            if show:
                self.screen.lines(_shown(robot, make(first.without_secrets()), self.folder))
        else:
            states = write.write(files, folder=self.folder)
        written = [name for name, state in states.items() if state == "written"]
        notes = [*lost(first), *_notes(first, destination)]
        key = host_keys.parse(first.host_key.public) if first.host_key else None
        recorded = key is not None and _unknown(robot, destination, key)
        if key and recorded and not self.dry:
            known_hosts.record(robot.known_hosts, name=destination.known_as, key=key)
        done = [f"{'would write' if self.dry else 'wrote'} {', '.join(written)}"] if written else []
        if key and recorded:
            done.append(
                "would record a new host key" if self.dry else f"recorded its host key {key.fingerprint}"
            )
        summary = f"{found.name}: {'; '.join(done) or 'the card is ready'}"
        if not self.dry:
            for note in notes:
                self.screen.say(program.typed(f"{robot.name}: {note}"))
        status: Status = "unchanged" if not done else "planned" if self.dry else "done"
        return Outcome(robot=robot.name, status=status, summary=summary)

    def _first_boot(
        self, robot: Robot, destination: Destination, found: System, there: Prepared
    ) -> FirstBoot:
        if destination.user == "root":
            raise UsageError(
                f"{robot.name}: fab card makes no login for root", cure="set `user:` in the inventory"
            )
        zone = robot.card.timezone or ""
        first_boot.check_timezone(zone, known=zoneinfo.available_timezones())
        wifi = robot.card.wifi
        files = (robot.identity_file,) if robot.identity_file else destination.identity_files
        first = FirstBoot(
            robot=robot.name,
            hostname=first_boot.hostname(robot),
            user=destination.user,
            keys=host_keys.authorized(files, comment=f"{getpass.getuser()}@{socket.gethostname()}"),
            timezone=zone,
            country=wifi.country if wifi else "",
            networks=tuple(self._network(one) for one in wifi.networks) if wifi else (),
            announces=robot.address.endswith(".local"),
        )
        match found.kind:
            case "cloud-init":
                return replace(first, host_key=_host_key(there, first))
            case "userconf.txt":
                return replace(first, password=self._password(robot, first.user))
            case _:
                return first

    def _network(self, one: values.Network) -> Network:
        if one.open:
            return Network(name=one.name, key="", hidden=one.hidden)
        return Network(name=one.name, key=self._wifi_key(one), hidden=one.hidden)

    def _wifi_key(self, one: values.Network) -> str:
        if one.passphrase is not None:
            return first_boot.wifi_key(one.passphrase.get_secret_value(), network=one.name)
        if one.passphrase_from:
            return first_boot.wifi_key(_exported(one.passphrase_from, one.name), network=one.name)
        if one.name not in self.passphrases:
            if self.dry:
                return HIDDEN
            self.passphrases[one.name] = self._asked(
                f"Passphrase of the Wi-Fi {one.name}:",
                cure=f"export it, and name the variable: `passphrase_from: VARIABLE` at the network {one.name}",
            )
        return first_boot.wifi_key(self.passphrases[one.name], network=one.name)

    def _password(self, robot: Robot, user: str) -> str:
        if self.dry:
            return HIDDEN
        text = (
            _exported(self.password_from, user)
            if self.password_from
            else self._asked(
                f"Password for the login {user} on {robot.name} (its system takes no SSH key):",
                cure="export it, and name the variable: --password-from VARIABLE",
            )
        )
        return password.hashed(text, salt=userconf.salt(write.text(self.folder / userconf.LOGIN)))

    def _asked(self, question: str, *, cure: str) -> str:
        if answer := self.screen.secret(question):
            return answer
        raise UsageError(f"no answer to: {question}", cure=cure)


def _host_key(there: Prepared, first: FirstBoot) -> HostKey:
    """The key that the card has already, so that a second run changes nothing; or a new one."""
    if there.robot == first.robot and there.host_key:
        return there.host_key
    private, public = host_keys.make(f"root@{first.hostname}")
    return HostKey(private=private, public=public)


def _maker(
    found: System, folder: Path
) -> tuple[Callable[[FirstBoot], dict[str, str]], Callable[[FirstBoot], Sequence[str]]]:
    """What writes the files for a system, and says what it cannot be told."""
    match found.kind:
        case "cloud-init":
            raspberry = found.raspberry_pi_os
            cmdlines = {name: write.text(folder / name) for name in system.CMDLINES}
            return lambda first: cloud_init.files(
                first, raspberry_pi_os=raspberry, cmdlines=cmdlines
            ), lambda _: ()
        case "custom.toml":
            return custom_toml.files, custom_toml.lost
        case "userconf.txt":
            return userconf.files, userconf.lost


def _notes(first: FirstBoot, destination: Destination) -> list[str]:
    notes = []
    if not first.host_key:
        notes.append(
            f"this system takes no host key: run `fab trust --hosts {first.robot}` when it has come up"
        )
    if destination.port != 22 and not destination.proxy_command:
        notes.append(f"its sshd will listen on port 22, and the inventory says {destination.port}")
    return notes


def _unknown(robot: Robot, destination: Destination, key: known_hosts.HostKey) -> bool:
    known = known_hosts.read((robot.known_hosts, *destination.known_hosts))
    return known.verdict(destination.known_as, key) != "known"


def _shown(robot: Robot, files: Mapping[str, str], folder: Path) -> list[str]:
    lines = []
    for name, content in files.items():
        lines += [f"{robot.name}: {folder / name}", *(f"  {line}" for line in content.splitlines())]
    return lines


def _exported(name: str, about: str) -> str:
    if value := os.environ.get(name):
        return value
    cure = f"`read -rs {name} && export {name}` asks for it without showing it"
    raise UsageError(f"the variable {name} ({about}) is not set", cure=cure)


def _where() -> str:
    """Name a folder that looks like a boot partition."""
    folders = (path.parent for place in _PLACES for path in Path("/").glob(f"{place[1:]}/config.txt"))
    there = [str(folder) for folder in folders if any((folder / name).is_file() for name in system.CMDLINES)]
    if there:
        return f"this looks like one: --boot {there[0]}"
    return (
        "insert it, and name the folder of its boot partition: fab card --hosts NAME --boot /media/YOU/bootfs"
    )


VERBS = (card,)
