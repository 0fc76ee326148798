"""Which robots does a command line select?"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fleet.config.inventory import Inventory, Robot


def select(inventory: str, hosts: str) -> tuple[Inventory, tuple[Robot, ...]]:
    """Load the inventory, and select the robots that ``--hosts`` names.

    Raises:
        InventoryError, SelectionError: as `fleet.config.inventory` says.

    """
    fleet = load(inventory)
    return fleet, fleet.select(hosts)


def load(inventory: str) -> Inventory:
    """Load the inventory that was named, or the usual one.

    Raises:
        InventoryError: as `fleet.config.inventory` says.

    """
    from fleet.config import inventory as inventories  # noqa: PLC0415  a quarter of all imports, and `fab --list` does without

    return inventories.load(_file(inventory or os.environ.get("FLEET_INVENTORY", "")))


def found() -> bool:
    """Whether there is an inventory for a verb without ``--inventory``."""
    return _file(os.environ.get("FLEET_INVENTORY", "")).exists()


def _file(named: str) -> Path:
    """Return the file that was named, or the nearest ``inventory.yaml`` from here upwards: ``fab`` works in subfolders."""
    if named:
        return Path(named)
    usual = Path("inventory.yaml")
    return next(
        (path for folder in (Path(), *Path.cwd().parents) if (path := folder / usual).exists()), usual
    )
