from __future__ import annotations

from fleet.config.inventory import Robot
from fleet.config.ros import Ros
from fleet.rollout import topic_list
from fleet.ros.topics import Topic
from tests.support.homes import Told, statuses
from tests.support.ros_peers import answering
from tests.support.sshd import free_port


def test_each_robots_topics_and_who_has_none() -> None:
    """One that fails does not hide the others."""
    state, types = [1, "", [[["/time", ["/a"]]], [], []]], [1, "", [["/time", "std_msgs/Time"]]]
    with answering({"getSystemState": lambda _: state, "getTopicTypes": lambda _: types}) as port:
        robots = [
            Robot(name=name, address="127.0.0.1", ros=Ros(master=f"http://127.0.0.1:{number}"))
            for name, number in (("pi1", free_port()), ("pi2", port))
        ]
        found, outcomes = topic_list.look(robots, timeout=1, progress=Told())
    assert found == {"pi2": (Topic(name="/time", type="std_msgs/Time", publishers=1),)}
    assert statuses(outcomes) == {"pi1": "unreachable", "pi2": "done"}
    assert outcomes[1].summary == "1 topics"
