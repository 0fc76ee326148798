"""Which robots does a line on the terminal mean?"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fleet.config.inventory import Inventory, Robot


def select(inventory: str, hosts: str) -> tuple[Inventory, tuple[Robot, ...]]:
    """The inventory that was named, and the robots that ``--hosts`` means.

    Raises:
        InventoryError, SelectionError: as `fleet.config.inventory` says.

    """
    from fleet.config import inventory as inventories  # noqa: PLC0415  a quarter of all imports, and `fab --list` does without

    fleet = inventories.load(_file(inventory or os.environ.get("FLEET_INVENTORY", "")))
    return fleet, fleet.select(hosts)


def _file(said: str) -> Path:
    """What was said, else the nearest ``inventory.yaml`` from here upwards: ``fab`` works in subfolders."""
    if said:
        return Path(said)
    usual = Path("inventory.yaml")
    return next(
        (path for folder in (Path(), *Path.cwd().parents) if (path := folder / usual).exists()), usual
    )
