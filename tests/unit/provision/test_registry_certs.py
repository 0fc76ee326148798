from __future__ import annotations

import hashlib

import pytest

from fleet.config.registry import Registry
from fleet.errors import NotReady
from fleet.plan.step import Bytes
from fleet.provision import registry_certs
from fleet.robot.image_store import ImageStore
from tests.support.samples import PI, facts

FILES = {"ca.crt": b"ca", "client.key": b"key"}
FOLDER = "/etc/docker/certs.d/reg.local:5000"
ROBOT = PI.model_copy(update={"transport": "registry", "registry": Registry(address="reg.local:5000/robots")})
KNOWS = ImageStore(
    certs={f"{FOLDER}/{name}": hashlib.sha256(data).hexdigest() for name, data in FILES.items()}
)


def test_what_is_missing_is_written_as_root_and_for_root_only() -> None:
    """The content is on standard input, where nobody on the robot can see it."""
    steps = registry_certs.steps(ROBOT, facts(), FILES)
    assert [(step.argv[-3], step.argv[-1]) for step in steps] == [
        (f"{FOLDER}/ca.crt", "secret"),
        (f"{FOLDER}/client.key", "secret"),
    ]
    assert [step.argv[0] for step in steps] == ["sudo"] * 2
    assert [step.feed for step in steps] == [Bytes(label=name, data=data) for name, data in FILES.items()]
    assert registry_certs.steps(ROBOT, facts(image_store=KNOWS), FILES) == ()
    (step,) = registry_certs.steps(ROBOT, facts(image_store=KNOWS), {**FILES, "ca.crt": b"new"})
    assert step.argv[-3] == f"{FOLDER}/ca.crt"


def test_ship_refuses_a_robot_that_lacks_them() -> None:
    """Before anything is pushed; without sudo nobody can look, and Docker finds out."""
    with pytest.raises(NotReady, match=r"does not know the registry reg.local:5000 yet: ca.crt") as refused:
        registry_certs.check(ROBOT, facts(), FILES)
    assert refused.value.cure == "`fab provision --hosts pi1`"
    registry_certs.check(ROBOT, facts(image_store=KNOWS), FILES)
    registry_certs.check(ROBOT, facts(sudo="password"), FILES)


def test_other_robots_need_nothing() -> None:
    """They pull through SSH, or not at all."""
    tunnelled = ROBOT.model_copy(update={"registry": None})
    by_ssh = ROBOT.model_copy(update={"transport": "ssh"})
    for robot in (tunnelled, by_ssh):
        assert registry_certs.steps(robot, facts(), FILES) == ()
        registry_certs.check(robot, facts(), FILES)
