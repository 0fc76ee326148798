"""Steps that let a robot's Docker trust a registry, and be known to it: the folder of that registry in ``/etc/docker/certs.d``.

Docker reads the folder at each pull (docs.docker.com/engine/security/certificates), so nothing has to be restarted.
``certificates`` are those of `fleet.cli.registry_access.certificates`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fleet.errors import NotReady
from fleet.provision import whole_file

if TYPE_CHECKING:
    from collections.abc import Mapping

    from fleet.config.inventory import Robot
    from fleet.plan.step import Step
    from fleet.robot.facts import Facts

FOLDER = "/etc/docker/certs.d"


def steps(robot: Robot, facts: Facts, certificates: Mapping[str, bytes]) -> tuple[Step, ...]:
    """The steps that write what a robot lacks of its registry's files, or has with another content. Only root can read them."""
    return tuple(
        whole_file.step(
            f"let Docker know the registry {path.split('/')[-2]} ({path.rpartition('/')[2]})",
            path,
            data,
            label=path.rpartition("/")[2],
            root=facts,
            secret=True,
        )
        for path, data in _missing(robot, facts, certificates).items()
    )


def check(robot: Robot, facts: Facts, certificates: Mapping[str, bytes]) -> None:
    """Refuse a robot that lacks them. Without sudo nobody can look, and Docker finds out.

    Raises:
        NotReady: a file is missing there, or another one.

    """
    lacks = _missing(robot, facts, certificates)
    if lacks and facts.login.sudo in ("root", "free"):
        names = ", ".join(path.rpartition("/")[2] for path in lacks)
        what = f"its Docker does not know the registry {robot.registry.host if robot.registry else ''} yet: {names}"
        raise NotReady(what, cure=f"`fab provision --hosts {robot.name}`")


def _missing(robot: Robot, facts: Facts, certificates: Mapping[str, bytes]) -> dict[str, bytes]:
    if robot.transport != "registry" or robot.registry is None:
        return {}
    there = facts.fleet.image_store.certs
    wanted = {f"{FOLDER}/{robot.registry.host}/{name}": data for name, data in certificates.items()}
    return {path: data for path, data in wanted.items() if there.get(path) != whole_file.digest(data)}
