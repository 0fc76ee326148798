"""Which topics do many robots publish?"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fleet.plan.outcome import Outcome
from fleet.rollout.pool import each
from fleet.ros import topics

if TYPE_CHECKING:
    from collections.abc import Sequence

    from fleet.config.inventory import Robot
    from fleet.rollout.link import Link
    from fleet.rollout.progress import Progress
    from fleet.ros.topics import Topic


def look(
    robots: Sequence[Robot], *, timeout: float, progress: Progress, measure: float = 0
) -> tuple[dict[str, tuple[Topic, ...]], tuple[Outcome, ...]]:
    """Return the topics of each robot that has some, in the order of ``robots``, and all outcomes.

    ``timeout``: seconds to find the nodes of a robot with ROS 2; ``measure``: seconds to count messages, 0 for none.
    """
    found: dict[str, tuple[Topic, ...]] = {}

    def work(link: Link) -> Outcome:
        name = link.robot.name
        found[name] = topics.topics(
            link.robot, timeout=timeout, on_robot=lambda argv: link.run(*argv), measure=measure
        )
        return Outcome(robot=name, status="done", summary=f"{len(found[name])} topics")

    outcomes = each(robots, work, progress=progress)
    return {robot.name: found[robot.name] for robot in robots if robot.name in found}, outcomes
