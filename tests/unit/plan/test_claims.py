from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pytest

from fleet.errors import NotReady
from fleet.plan import claims
from fleet.robot.claims import Claim, Port
from tests.support.samples import release


def check(service: dict[str, Any], *there: Claim) -> None:
    claims.check(replace(release(), compose=json.dumps({"services": {"node": service}})), there)


WANTS = {"container_name": "cam", "ports": [{"target": 80, "published": "8080", "protocol": "tcp"}]}


@pytest.mark.parametrize(
    ("there", "what", "cure"),
    [
        (
            Claim(name="cam", project="other"),
            "service node wants the container name cam, which container cam of stack other has",
            "change `container_name:` of node, or remove the other one: `fab remove --stack other`",
        ),
        (
            Claim(name="web", ports=(Port(number=8080),)),
            "service node wants port 8080/tcp of the robot, which container web has",
            "change `ports:` of node, or stop the other one: `docker rm -f web` on the robot",
        ),
    ],
)
def test_what_another_has_is_refused(there: Claim, what: str, cure: str) -> None:
    """Before anything is sent, with who has it."""
    with pytest.raises(NotReady) as caught:
        check(WANTS, there)
    assert (caught.value.what, caught.value.cure) == (what, cure)


def test_what_the_stack_itself_has_is_its_own() -> None:
    """The next release takes the place of this one."""
    check(WANTS, Claim(name="cam", project="talker", ports=(Port(number=8080),)))


@pytest.mark.parametrize(
    "port", [{"target": 80}, {"target": 80, "published": ""}, {"target": 80, "published": "9000-9001"}]
)
def test_other_ports_are_free(port: dict[str, object]) -> None:
    """Docker chooses one where the file names none."""
    check({"ports": [port]}, Claim(name="web", ports=(Port(number=8080),)))


def test_one_port_of_a_range() -> None:
    """Is enough."""
    with pytest.raises(NotReady, match="port 8081/tcp"):
        check(
            {"ports": [{"target": 80, "published": "8080-8082"}]},
            Claim(name="web", ports=(Port(number=8081),)),
        )
