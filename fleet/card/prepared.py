"""What has `fab card` written onto a card earlier? For whom, with which host key, and has the robot booted since?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from fleet.card import cloud_init, custom_toml, first_boot, userconf, write
from fleet.errors import UsageError

if TYPE_CHECKING:
    from pathlib import Path

    from fleet.card.first_boot import HostKey

_MARKED = (cloud_init.USER_DATA, custom_toml.FILE, userconf.SSH, userconf.WIFI)
"""The files that tell for whom a card is, of all systems."""


@dataclass(frozen=True, kw_only=True)
class Prepared:
    """A card as `fab card` left it, or as the robot has it after its first boot. ``robot`` is "" if it was not prepared."""

    folder: Path
    robot: str = ""
    host_key: HostKey | None = None
    booted: bool = False

    def check(self, robot: str) -> None:
        """Refuse a card that is not for ``robot``, or that has done its work.

        Raises:
            UsageError: it was prepared for another robot, or its robot has booted from it.

        """
        if self.robot and self.robot != robot:
            raise UsageError(
                f"the card at {self.folder} was prepared for the robot {self.robot}",
                cure="insert the right card; to use this one, write it again, or say --overwrite",
            )
        if self.booted:
            raise UsageError(
                f"{robot} has booted from the card at {self.folder} already, and has read what was on it",
                cure="change the robot over SSH; or write the card again; or say --overwrite: then it is set up again at its "
                "next boot, with a new host key, and keeps its other files",
            )


def look(folder: Path) -> Prepared:
    """Read what is on a card.

    Raises:
        DesktopError: it cannot be read.

    """
    owners = (first_boot.prepared_for(write.text(folder / name)) for name in _MARKED)
    owner = next(filter(None, owners), "")
    there = write.text(folder / cloud_init.USER_DATA)
    if not first_boot.prepared_for(there):
        return Prepared(folder=folder, robot=owner)
    key = cloud_init.host_key(there, path=folder / cloud_init.USER_DATA)
    # The first boot cuts the key off when it has set it.
    return Prepared(folder=folder, robot=owner, host_key=key, booted=key is None)
