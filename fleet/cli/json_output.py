"""How are our values printed as JSON?"""

from __future__ import annotations

import dataclasses
import json
import re
from typing import TYPE_CHECKING

from fleet.terminal import UNSAFE

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_UNSAFE = re.compile(f"[{UNSAFE}]")


def text(value: object) -> str:
    r"""Return indented JSON. Dataclasses become objects and paths text. Bytes may hold secrets: only their number is shown.

    What could steer a terminal is written as ``\u009b``: programs read the same, and people may look at it.
    """
    return _safe(json.dumps(_plain(value), indent=2, ensure_ascii=False))


def line(value: object) -> str:
    """Return the same on one line, for values that come one after the other."""
    return _safe(json.dumps(_plain(value), ensure_ascii=False))


def _safe(written: str) -> str:
    return _UNSAFE.sub(lambda found: f"\\u{ord(found[0]):04x}", written)


def _plain(value: object) -> object:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, bytes):
        return f"{len(value)} bytes"
    return value if isinstance(value, str | int | float | bool | None) else str(value)


def flat(values: Mapping[str, object], before: str = "") -> Iterator[tuple[str, object]]:
    """Each value of nested objects, with its path: ``docker.version``."""
    for key, value in values.items():
        if isinstance(value, dict):
            yield from flat(value, f"{before}{key}.")
        else:
            yield f"{before}{key}", value
