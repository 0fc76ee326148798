"""Inventories for tests, written where the test runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from fleet.config.inventory import Inventory, load
from fleet.errors import InventoryError


def write(source: str, name: str = "inventory.yaml") -> Path:
    """The file ``name`` with ``source`` in it, its folders made."""
    path = Path(name)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(source, encoding="utf-8")
    return path


def inventory(source: str) -> Inventory:
    """The inventory that ``source`` is."""
    return load(write(source))


def problems(source: str) -> list[str]:
    """What is wrong with the inventory ``source``, each problem once, with paths as in the message."""
    with pytest.raises(InventoryError) as raised:
        inventory(source)
    first, *rest = str(raised.value).replace(f"{Path.cwd()}/", "").split("\n  ")
    assert (first == f"inventory.yaml has {len(rest)} problems:") == bool(rest)
    return rest or [first]
