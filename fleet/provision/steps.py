"""Plan the steps that make a robot ready for containers, from a fresh system or from an incomplete attempt.

Only what is not right yet gets a step. Docker is installed by its convenience script, which the desktop fetches and sends.
If Docker is installed, the script does not run again, because it would restart the robot's containers. An exit code of 0
proves nothing here (the script returns it after many failures), so the last steps prove the result on a new login.
"""

from __future__ import annotations

import hashlib
import re
from types import MappingProxyType
from typing import TYPE_CHECKING

from fleet import onboard
from fleet.errors import NotReady
from fleet.plan import readiness
from fleet.plan.step import Bytes, Plan, Record, Step
from fleet.provision import apt, daemon_json, hardware, jetson, registry_certs, sudo, whole_file
from fleet.provision.sudo import as_root
from fleet.robot.paths import HOME
from fleet.units import human_bytes

if TYPE_CHECKING:
    from collections.abc import Mapping

    from fleet.config.inventory import Robot
    from fleet.robot.facts import Facts

ROOM = 1_000_000_000
"""Free disk space in bytes that an installation needs: the packages, their unpacked files, and a reserve."""

CLOCK_MAY_DIFFER = 60.0
"""Seconds. A Pi has no clock of its own; apt and TLS refuse files and certificates that seem to come from the future."""

_DEFAULT = apt.Bounds()
_NONE: Mapping[str, bytes] = MappingProxyType({})
_CLASHING = ("docker-buildx", "docker-compose", "docker-compose-v2")
"""Packages of Debian and Ubuntu that contain files of Docker's own packages; dpkg refuses to install both."""

_AGAIN = "run the same command again"

SCRIPT = f"{HOME}/get-docker.sh"
BOOT = f"{HOME}/boot.sh"
PROOF_IMAGE = "fleet-proof"

_GROUP = 'groupadd --force --system docker && usermod --append --groups docker "$1"'
_RESTART = "systemctl reset-failed docker.service docker.socket; systemctl enable --now docker"
_IS_INSTALLED = "command -v docker || { echo 'the script ended without an error, and did not install Docker' >&2; exit 1; }"
_REMOVE_SOURCE = "command -v docker > /dev/null || rm -f /etc/apt/sources.list.d/docker.list"


def plan(
    *,
    robot: Robot,
    facts: Facts,
    script: bytes,
    now: float,
    by: str,
    certificates: Mapping[str, bytes] = _NONE,
    bounds: apt.Bounds = _DEFAULT,
) -> Plan:
    """The steps after which Docker works for the robot's login; a plan without steps if it works already.

    ``script`` is Docker's convenience script; it may be empty if `needs_script` is false. ``now`` is the current time in
    seconds since the epoch. ``certificates`` are those of the robot's registry (`fleet.cli.registry_access.certificates`).

    Raises:
        NotReady: the user has to change something on the robot or in the inventory first.

    """
    _check_kind(robot, facts)
    _check_version(robot, facts)
    install = _installation(robot, facts, script=script, bounds=bounds)
    changes = _changes(robot, facts, install=install, certificates=certificates, now=now)
    zstd = apt.zstd(facts=facts, bounds=bounds)
    steps = changes or zstd
    if not steps:
        return Plan(
            robot=robot.name,
            summary=f"Docker {facts.docker.version} with Compose {facts.docker.compose}{_reboot(robot, facts)}",
        )
    sudo.check(facts)
    return Plan(
        robot=robot.name,
        summary=_summary(robot, facts),
        verb="provision",
        steps=(*steps, *_proof(robot), *jetson.proof(facts)),
        explain=(_journal(facts),),
        recover=(_remove_source(facts),) if needs_script(facts) else (),
        afterwards=zstd if changes else (),
        record=Record(verb="provision", release="", by=by),
    )


def _changes(
    robot: Robot, facts: Facts, *, install: tuple[Step, ...], certificates: Mapping[str, bytes], now: float
) -> tuple[Step, ...]:
    if install:
        _check_disk(facts)
    return (
        *_clock(facts, now=now),
        *hardware.steps(robot, facts),
        *daemon_json.steps(robot, facts),
        *registry_certs.steps(robot, facts, certificates),
        *install,
        *_login(facts),
        *_boot(facts),
        *jetson.reload(facts),
        *_finish(facts),
        *_boot_unit(robot, facts),
    )


def needs_script(facts: Facts) -> bool:
    """Whether Docker's convenience script has to run: no Docker is installed, from any source."""
    return facts.docker.state == "absent" and not facts.docker.kind and not _engine_package(facts)


def _engine_package(facts: Facts) -> str:
    return next((name for name in ("docker-ce", "docker.io") if name in facts.packages.installed), "")


def _summary(robot: Robot, facts: Facts) -> str:
    installed = facts.docker.version or facts.docker.client
    which = f"Docker {robot.docker.version or 'installed'}" if not installed else f"Docker {installed}"
    return f"{which}, ready for {facts.login.name}{_reboot(robot, facts)}"


def _reboot(robot: Robot, facts: Facts) -> str:
    """What waits for a reboot, and how to do it: fleet never reboots a robot, which may be driving."""
    wanted = [name for name in robot.hardware.interfaces if name not in facts.hardware.interfaces]
    if waiting := ", ".join(dict.fromkeys((*facts.hardware.reboot_for, *wanted))):
        return f"; reboot it to switch on {waiting}: `fab run --hosts {robot.name} -- sudo reboot`"
    return ""


def _check_kind(robot: Robot, facts: Facts) -> None:
    """Check what no step can change: other engines, the system's commands, its processor."""
    readiness.manageable(facts, then=_AGAIN)
    if robot.platform in facts.host.platforms:
        return
    if not facts.host.platforms:
        raise readiness.no_platform(facts)
    fitting = f"set `platform: {facts.host.platforms[0]}` for {robot.name} in the inventory"
    if facts.host.machine == "aarch64" and facts.host.platforms[0] == "linux/arm/v7":
        raise NotReady(
            f"its kernel is 64-bit and its system ({facts.host.os}) is 32-bit, and the inventory says {robot.platform}",
            cure=f"write the 64-bit Raspberry Pi OS to its SD card, or {fitting}",
        )
    raise NotReady(
        f"it runs {' and '.join(facts.host.platforms)}, and the inventory says {robot.platform}", cure=fitting
    )


def _check_version(robot: Robot, facts: Facts) -> None:
    pin, installed = robot.docker.version, facts.docker.version or facts.docker.client
    version = _numbers(installed or pin or "")
    jetson.check_version(robot, facts, major=version[0] if version else None)
    if not pin or not installed or _numbers(pin) == _numbers(installed):
        return
    remove = f"remove Docker on the robot (its containers stop; images stay), then {_AGAIN}"
    if _numbers(pin) < _numbers(installed):
        raise NotReady(
            f"Docker {installed} is installed, and the inventory pins {pin}: fleet does not downgrade",
            cure=f"change the pin; or {remove}",
        )
    raise NotReady(
        f"Docker {installed} is installed, and the inventory pins {pin}: an upgrade would restart its containers",
        cure=f"upgrade Docker on the robot at a suitable time (`sudo apt-get install --only-upgrade "
        f"{_engine_package(facts) or 'docker-ce'}`); or {remove}",
    )


def _numbers(version: str) -> tuple[int, ...]:
    """``26.1.5+dfsg1`` -> (26, 1, 5)."""
    return tuple(int(part) for part in re.split(r"[^0-9.]", version)[0].split(".") if part)


def _check_disk(facts: Facts) -> None:
    if facts.disk.size and facts.disk.free < ROOM:
        raise NotReady(
            f"it needs {human_bytes(ROOM)} of free disk, and has {human_bytes(facts.disk.free)}",
            cure="free some space on the robot: `sudo apt-get clean`; `sudo du -xh / | sort -h | tail` shows large folders",
        )


def _clock(facts: Facts, *, now: float) -> tuple[Step, ...]:
    if abs(facts.host.clock - now) <= CLOCK_MAY_DIFFER:
        return ()
    return (
        Step(title="set the clock", argv=as_root(facts, "date", "--utc", "--set", f"@{now:.0f}"), limit=20.0),
    )


def _installation(robot: Robot, facts: Facts, *, script: bytes, bounds: apt.Bounds) -> tuple[Step, ...]:
    """Install what is missing: Docker with its script, or packages that an installed Docker lacks."""
    if needs_script(facts):
        steps = _by_script(robot, facts, script=script, bounds=bounds)
    else:
        steps = _by_packages(facts, bounds=bounds)
    broken = facts.packages.interrupted and (steps or facts.docker.state == "stopped")
    return (
        *((apt.reachable(bounds=bounds),) if steps else ()),
        *((apt.repair(facts=facts, bounds=bounds),) if broken else ()),
        *steps,
    )


def _by_script(robot: Robot, facts: Facts, *, script: bytes, bounds: apt.Bounds) -> tuple[Step, ...]:
    clashing = tuple(name for name in facts.packages.installed if name in _CLASHING)
    remove = apt.run(
        f"remove {' and '.join(clashing)}, which clash with Docker's own packages",
        (*apt.REMOVE, *clashing),
        facts=facts,
        bounds=bounds,
    )
    pin = ("--version", robot.docker.version) if robot.docker.version else ()
    run = ("sh", SCRIPT, *pin)
    title = f"install Docker{' '.join(('', *pin[1:]))}, which takes minutes"
    return (
        *((_remove_source(facts),) if facts.packages.docker_source else ()),
        *((remove,) if clashing else ()),
        _send(robot, script),
        apt.run(title, run, facts=facts, bounds=bounds),
        Step(
            title="prove that the script installed Docker",
            argv=("sh", "-c", _IS_INSTALLED),
            limit=20.0,
            cure=f"`sudo sh -x {SCRIPT}` on the robot shows what the script does",
        ),
        Step(title="remove the script", argv=("rm", "-f", SCRIPT), limit=20.0),
    )


def _by_packages(facts: Facts, *, bounds: apt.Bounds) -> tuple[Step, ...]:
    client = "docker-ce-cli" if _engine_package(facts) == "docker-ce" else "docker-cli"
    add_client = apt.run(f"install {client}", (*apt.INSTALL, client), facts=facts, bounds=bounds)
    add_compose = apt.compose_plugin(facts=facts, bounds=bounds)
    return (
        *((add_client,) if facts.docker.state == "absent" else ()),
        *((add_compose,) if not facts.docker.compose else ()),
    )


def _send(robot: Robot, script: bytes) -> Step:
    """Send the script. What root runs later is what the desktop has looked at: the robot compares its digest."""
    return whole_file.step(
        f"send Docker's script ({robot.docker.script})",
        SCRIPT,
        script,
        label=f"the script, sha256 {hashlib.sha256(script).hexdigest()}",
        limit=60.0,
    )


def _login(facts: Facts) -> tuple[Step, ...]:
    member = "docker" in facts.login.groups or facts.login.name in (facts.docker.members or ())
    if member or facts.login.sudo == "root" or facts.docker.state == "ready":
        return ()
    return (
        Step(
            title=f"let {facts.login.name} use Docker",
            argv=as_root(facts, "sh", "-c", _GROUP, "sh", facts.login.name),
            limit=20.0,
        ),
    )


def _boot(facts: Facts) -> tuple[Step, ...]:
    if facts.docker.state == "ready" and facts.docker.starts_at_boot:
        return ()
    if facts.docker.state == "stopped":
        # systemd refuses to start a service that failed several times within a minute, until that is reset.
        argv = as_root(facts, "sh", "-c", _RESTART)
    else:
        argv = as_root(facts, "systemctl", "enable", "--now", "docker")
    return (Step(title="start Docker now and at every boot", argv=argv, limit=120.0),)


def finish_unit(login: str) -> str:
    """The text of the unit that finishes, at boot, the swap of containers that a power cut has interrupted."""
    return onboard.source("finish.service").replace("LOGIN", login)


def _finish(facts: Facts) -> tuple[Step, ...]:
    unit = finish_unit(facts.login.name).encode()
    if facts.docker.finish_unit in (hashlib.sha256(unit).hexdigest(), "no systemd"):
        return ()
    return (_unit(facts, "fleet-finish", unit, why="let the robot finish a swap after a power cut"),)


def _unit(facts: Facts, name: str, text: bytes, *, why: str, restart: bool = False) -> Step:
    run = ("sh", "-c", onboard.text("systemd_unit.sh"), "systemd_unit", name)
    how = (whole_file.digest(text), onboard.text("replace_file.sh"), *(("restart",) if restart else ()))
    return Step(
        title=f"{why} ({name}.service)",
        argv=as_root(facts, *run, *how),
        feed=Bytes(label=f"{name}.service", data=text),
        limit=60.0,
    )


def boot_unit(login: str) -> tuple[bytes, bytes]:
    """The unit that starts stacks which systemd owns, and the script that it runs."""
    return onboard.source("boot.service").replace("LOGIN", login).encode(), onboard.source("boot.sh").encode()


def _boot_unit(robot: Robot, facts: Facts) -> tuple[Step, ...]:
    """Install it if the inventory says so. It is never removed: it leaves stacks alone that are Docker's."""
    if robot.boot != "systemd":
        return ()
    if facts.docker.boot_unit == "no systemd":
        raise NotReady("it has no systemd to start the stacks", cure=f"set `boot: docker` for {robot.name}")
    unit, script = boot_unit(facts.login.name)
    if facts.docker.boot_unit == hashlib.sha256(unit + script).hexdigest():
        return ()
    return (
        whole_file.step(
            "write what systemd runs at power-on (~/.fleet/boot.sh)", BOOT, script, label="boot.sh"
        ),
        _unit(facts, "fleet-boot", unit, why="let systemd start the stacks at power-on", restart=True),
    )


def _proof(robot: Robot) -> tuple[Step, ...]:
    """Prove on a new login that Docker, Compose and containers work."""
    version = ("docker", "version", "--format", '{{index (split .Server.Version "+") 0}}')
    return (
        Step(
            title="prove that Docker answers this login",
            argv=version,
            expect=robot.docker.version,
            fresh_login=True,
        ),
        Step(title="prove that Compose is installed", argv=("docker", "compose", "version")),
        Step(
            title="prove that Docker starts at boot",
            argv=("systemctl", "is-enabled", "docker"),
            expect="enabled",
            limit=20.0,
        ),
        Step(
            title="prove that a container runs",
            argv=("sh", "-c", onboard.text("prove_container.sh"), "prove_container", PROOF_IMAGE),
            limit=120.0,
        ),
    )


def _remove_source(facts: Facts) -> Step:
    """Remove the package source that a failed installation left: it would make every ``apt-get update`` fail."""
    return Step(
        title="remove Docker's package source",
        argv=as_root(facts, "sh", "-c", _REMOVE_SOURCE),
        limit=20.0,
    )


def _journal(facts: Facts) -> Step:
    """Show why Docker does not start: systemctl says only that it failed."""
    return Step(
        title="show the end of Docker's journal",
        argv=as_root(facts, "sh", "-c", onboard.text("docker_journal.sh"), "docker_journal"),
        limit=20.0,
    )
