"""How are a plan and an outcome shown as text?"""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fleet.plan.outcome import Outcome
    from fleet.plan.step import Plan, Step

from fleet.robot.paths import HISTORY
from fleet.units import human_bytes, human_seconds

LONG_SCRIPT = 14
"""A script with more lines than this after its first is shown by its first, which is a comment."""


def headline(outcome: Outcome) -> str:
    """A robot's outcome in one line, to be printed after its name."""
    if outcome.good:
        took = f", {human_seconds(outcome.seconds)}" if outcome.status == "done" else ""
        sent = f", sent {human_bytes(outcome.sent)}" if outcome.sent else ""
        sent += f" ({outcome.transfer})" if outcome.transfer else ""
        return f"{outcome.summary}{sent}{took}"
    first = outcome.reason.splitlines()[0] if outcome.reason else ""
    return f"{outcome.step}: {first}" if outcome.step else first


def details(outcome: Outcome) -> list[str]:
    """The lines below a robot's headline: the rest of the reason (log lines), then the cure."""
    if outcome.good:
        return []
    lines = [f"  | {line}" for line in outcome.reason.splitlines()[1:]]
    return [*lines, f"  cure: {outcome.cure}"] if outcome.cure else lines


def lines(plan: Plan) -> list[str]:
    """The plan as the text that ``--dry`` prints: a heading, then each command as one could type it on the robot."""
    sends = f", sends {human_bytes(plan.size)}" if plan.size else ""
    name = f"{plan.robot}: {plan.stack}" if plan.stack else plan.robot
    text = [f"{name}: {plan.summary}{sends}" if plan.steps else f"{name}: unchanged, {plan.summary}"]
    for number, step in enumerate(plan.steps, start=1):
        text += [f"  {number}. {step.title}", _command(step)]
    if plan.forecast and plan.steps:
        text.insert(1, f"  {plan.forecast}")
    for step in (*plan.explain, *plan.recover):
        text += [f"  if a step fails: {step.title}", _command(step)]
    for step in plan.afterwards:
        text += [f"  when all is well: {step.title}", _command(step)]
    if plan.record and plan.steps:
        text += [f"  at the end: one line into ~/{HISTORY}"]
    return text


def _command(step: Step) -> str:
    fed = f"   # reads {step.feed.label}, {human_bytes(step.feed.size)}" if step.feed else ""
    return f"     $ {shlex.join(map(_shown, step.argv))}{fed}"


def _shown(argument: str) -> str:
    """The argument, or for a long script only its first line after ``#!``, which says what the script does."""
    script = argument.partition("\n")[2] if argument.startswith("#!") else argument
    first, _, rest = script.partition("\n")
    count = len(rest.splitlines())
    return f"{first} [{count} more lines: --dry --json]" if count > LONG_SCRIPT else argument
