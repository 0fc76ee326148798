from __future__ import annotations

import pytest
from pydantic import ValidationError

from fleet.config.ros import Ros


def test_ros_1_is_the_default() -> None:
    """Each robot with a master of its own; nothing of ROS 2 is set."""
    assert Ros().model_dump(exclude_none=True) == {"version": 1, "master": "own", "strict": False}


@pytest.mark.parametrize("domain", [0, 101, 215, 232])
def test_domains_whose_ports_are_free(domain: int) -> None:
    """Between these, Linux gives the ports to other programs."""
    assert Ros(version=2, domain=domain).domain == domain


@pytest.mark.parametrize(
    "values",
    [
        {"version": 3},
        {"version": 2, "domain": 102},
        {"version": 2, "domain": 300},
        {"version": 2, "rmw": "rmw_cyclone_cpp"},
        {"version": 2, "discovery": "everywhere"},
        {"version": 2, "hostname": "pi1"},
        {"hostname": "pi1", "ip": "192.0.2.1"},
    ],
    ids=str,
)
def test_what_does_not_go_together_is_refused(values: dict[str, object]) -> None:
    """A key of the other version, two names, a domain without ports, a middleware that is misspelt."""
    with pytest.raises(ValidationError):
        Ros.model_validate(values)
