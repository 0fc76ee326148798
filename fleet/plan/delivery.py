"""How do images come to a robot?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fleet.plan.step import Step


@dataclass(frozen=True, kw_only=True)
class Delivery:
    """The steps that bring the missing images. ``forecast`` says what they will take, ``transfer`` how they do it.

    ``way`` is the way in the robot's history, if it is not SSH: ``registry 10.0.0.5:5000``.
    """

    steps: tuple[Step, ...] = ()
    forecast: str = ""
    transfer: str = ""
    way: str = ""
