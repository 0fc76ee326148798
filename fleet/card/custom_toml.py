"""What does Raspberry Pi OS bookworm read at its first boot? ``custom.toml``.

Its format is that of ``init_config`` in the package raspberrypi-sys-mods. It takes one Wi-Fi network, and no host key.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from fleet.card.first_boot import MARK

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from fleet.card.first_boot import FirstBoot

FILE = "custom.toml"


def files(first: FirstBoot) -> dict[str, str]:
    """Return the files by name."""
    tables: dict[str, Mapping[str, object]] = {
        "system": {"hostname": first.hostname},
        "user": {"name": first.user},  # without a password it is locked, and logs in with keys
        "ssh": {"enabled": True, "password_authentication": False, "authorized_keys": list(first.keys)},
    }
    if first.networks:
        one = first.networks[0]
        key = {"password": one.key, "password_encrypted": True} if one.key else {}
        tables["wlan"] = {"ssid": one.name, **key, "hidden": one.hidden, "country": first.country}
    if first.timezone:
        tables["locale"] = {"timezone": first.timezone}
    # The system removes the file when it has read it.
    lines = [f"{MARK}{first.robot}", "config_version = 1"]
    for name, table in tables.items():
        lines += ["", f"[{name}]", *_lines(table)]
    return {FILE: "\n".join(lines) + "\n"}


def lost(first: FirstBoot) -> tuple[str, ...]:
    """Say what this system cannot be told."""
    others = ", ".join(one.name for one in first.networks[1:])
    return (f"this system takes one Wi-Fi network, so these are left out: {others}",) if others else ()


def _lines(table: Mapping[str, object]) -> Iterator[str]:
    # Strings, lists of them and truth values are written the same in JSON and in TOML.
    return (f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in table.items())
