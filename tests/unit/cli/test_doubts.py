from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

import pytest

from fleet.cli import doubts
from fleet.cli.stacks import RobotStack
from fleet.config.inventory import Robot, StackFiles
from fleet.config.ros import Ros
from fleet.errors import UsageError
from tests.support.samples import PROJECT, TALKER, stack

if TYPE_CHECKING:
    from fleet.images.image import Image
    from fleet.images.store import Store

NODE: dict[str, Any] = {
    "image": "talker",
    "network_mode": "host",
    "environment": {"ROS_DOMAIN_ID": "7", "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"},
}


def robot(name: str = "pi1", **ros: object) -> Robot:
    return Robot(name=name, address=name, ros=Ros.model_validate({"version": 2, "domain": 7, **ros}))


def silent(*robots: Robot) -> dict[str, tuple[RobotStack, ...]]:
    """A stack of two services that do not share their memory, for each robot."""
    one = RobotStack(
        spec=StackFiles(files=PROJECT.files),
        project=PROJECT,
        stack=stack(talker=NODE, listener=NODE),
        environment={},
        warnings=(),
    )
    return {robot.name: (one,) for robot in robots}


class Shelf:
    """A store with one image, which has one middleware."""

    def __init__(self, *there: str) -> None:
        self._there, self.looked = there, 0

    def find(self, _reference: str, _platform: str) -> Image:
        return TALKER

    def environment(self, _image: Image) -> dict[str, str]:
        return {"ROS_DISTRO": "jazzy"}

    def names_in(self, _image: Image, folder: str) -> frozenset[str]:
        assert folder.startswith("/opt/ros/jazzy/")
        self.looked += 1
        return frozenset(self._there)


def test_a_warning_or_a_refusal() -> None:
    """By the inventory of each robot; the refusal says how to have a warning only."""
    lax, strict, other = robot("pi1"), robot("pi2", strict=True), robot("pi3", strict=True)
    about = doubts.of_stacks([lax, strict, other], silent(lax, strict, other))
    assert about["pi1"] == about["pi2"]
    assert about["pi1"][0].startswith("no message of ROS 2 will arrive between talker and listener: ")
    doubts.refuse([lax], about)
    with pytest.raises(UsageError) as caught:
        doubts.refuse([lax, strict], about)
    assert caught.value.what.startswith("pi2: no message of ROS 2 will arrive between talker and listener: ")
    assert caught.value.cure.startswith("write `ipc: host` and the same `user:`")
    assert "`strict:`" in caught.value.cure
    with pytest.raises(UsageError, match=r"pi2 \(and 1 more robots\): no message"):
        doubts.refuse([lax, strict, other], about)
    doubts.refuse([strict], {"pi2": ()})


def test_a_middleware_that_the_image_lacks() -> None:
    """Each image is looked into once; services that ask for no middleware are not judged."""
    robots = [robot("pi1"), robot("pi2")]
    shelf = Shelf("rmw_cyclonedds_cpp")
    about = doubts.of_images(robots, silent(*robots), cast("Store", shelf))
    assert [len(texts) for texts in about.values()] == [2, 2]
    assert "talker has no rmw_fastrtps_cpp, only rmw_cyclonedds_cpp" in about["pi1"][0]
    assert shelf.looked == 1
    assert doubts.of_images(robots, silent(*robots), cast("Store", Shelf("rmw_fastrtps_cpp"))) == {
        "pi1": [],
        "pi2": [],
    }
