from __future__ import annotations

import pytest

from fleet.ros.middleware import folders, warning

INDEX = "share/ament_index/resource_index/rmw_typesupport"


def test_where_the_names_are() -> None:
    """In the distribution of ROS, and in each prefix that the image sets."""
    assert folders({"ROS_DISTRO": "jazzy"}) == (f"/opt/ros/jazzy/{INDEX}",)
    assert folders({"ROS_DISTRO": "jazzy", "AMENT_PREFIX_PATH": "/opt/nav:/opt/ros/jazzy"}) == (
        f"/opt/nav/{INDEX}",
        f"/opt/ros/jazzy/{INDEX}",
    )
    assert folders({"PATH": "/bin"}) == ()


@pytest.mark.parametrize(
    ("there", "warned"),
    [
        ({"rmw_fastrtps_cpp", "rmw_implementation"}, True),
        ({"rmw_fastrtps_cpp", "rmw_cyclonedds_cpp"}, False),
        ({"rmw_implementation"}, False),
        (set(), False),
    ],
)
def test_a_middleware_that_is_missing(there: set[str], warned: bool) -> None:
    """What is there is named, and the package; of an image with its ROS elsewhere, nothing is known."""
    said = warning("rmw_cyclonedds_cpp", service="nav", image="nav:1", there=there)
    assert bool(said) == warned
    if warned:
        assert said.startswith(
            "the nodes of the service nav will not start: nav:1 has no rmw_cyclonedds_cpp, only rmw_fastrtps_cpp; "
        )
        assert "ros-$ROS_DISTRO-rmw-cyclonedds-cpp" in said
