"""How do images come to a robot?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fleet.plan.step import Step


@dataclass(frozen=True, kw_only=True)
class Delivery:
    """The steps that bring images, nothing where none is missing; what they will take, and how they do it, in words."""

    steps: tuple[Step, ...] = ()
    forecast: str = ""
    way: str = ""
