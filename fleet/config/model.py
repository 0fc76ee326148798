"""What do all values of an inventory have in common?"""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Frozen(BaseModel):
    """A value that does not change and knows no other keys."""

    # Built at first use: `fab --list` reads no inventory.
    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, regex_engine="python-re", defer_build=True
    )
