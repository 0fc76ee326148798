"""Does a release want a name or a port that another container on the robot has? Docker would say so only after the old one was stopped."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from fleet.errors import Refused
from fleet.robot.claims import ANY, Port

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from typing import Any

    from fleet.robot.claims import Claim
    from fleet.robot.release import Release


def check(release: Release, claims: tuple[Claim, ...]) -> None:
    """Refuse a release that cannot start beside what else is on the robot.

    Raises:
        Refused: the first such name or port, and who has it.

    """
    others = [claim for claim in claims if claim.project != release.stack]
    model = json.loads(release.compose)
    for service, value in model["services"].items():
        name = value.get("container_name")
        if taken := next((claim for claim in others if claim.name == name), None):
            raise Refused(
                f"service {service} wants the container name {name}, which {_owner(taken)} has",
                cure=f"change `container_name:` of {service}, or remove the other one: {_removal(taken)}",
            )
        for port in published(value):
            if taken := next((claim for claim in others if any(map(port.clashes, claim.ports))), None):
                raise Refused(
                    f"service {service} wants port {port.number}/{port.protocol} of the robot, which {_owner(taken)} has",
                    cure=f"change `ports:` of {service}, or stop the other one: {_removal(taken)}",
                )


def _owner(claim: Claim) -> str:
    return f"container {claim.name}" + (f" of stack {claim.project}" if claim.project else "")


def _removal(claim: Claim) -> str:
    return (
        f"`fab remove --stack {claim.project}`"
        if claim.project
        else f"`docker rm -f {claim.name}` on the robot"
    )


def published(service: Mapping[str, Any]) -> Iterator[Port]:
    """The ports of the robot that a service of the canonical model asks for by number."""
    for port in service.get("ports") or ():
        first, _, last = str(port.get("published") or "").partition("-")
        address = str(port.get("host_ip") or "")
        if first.isdecimal() and (not last or last.isdecimal()):
            for number in range(int(first), int(last or first) + 1):
                yield Port(
                    number=number,
                    protocol=port.get("protocol") or "tcp",
                    address="" if address in ANY else address,
                )
