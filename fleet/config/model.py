"""What do all values of an inventory have in common?"""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from fleet.config import validation


class Frozen(BaseModel):
    """A value that does not change and knows no other keys."""

    # Built at first use: `fab --list` reads no inventory.
    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, regex_engine="python-re", defer_build=True
    )


Members = list[Annotated[str, Field(pattern=validation.MEMBER)]]
"""Names of robots and groups, and wildcards."""
