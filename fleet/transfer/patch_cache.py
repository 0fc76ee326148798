"""Make patches between layers that were packed on this computer; each patch is made once and kept."""

from __future__ import annotations

import contextlib
import json
import threading
from typing import TYPE_CHECKING

from fleet.plan.step import Upload
from fleet.transfer import patch_format

if TYPE_CHECKING:
    from fleet.transfer.layer_cache import LayerCache


class PatchCache:
    """The patches, kept in the cache of the layers."""

    def __init__(self, cache: LayerCache) -> None:
        self._cache = cache
        # One patch at a time: many robots need the same one, and each takes two unpacked layers on the disk.
        self._lock = threading.Lock()

    def make(self, *, old: str, new: str) -> Upload | None:
        """The patch that turns layer ``old`` into ``new`` (diff IDs); None if one of them was never packed here.

        Raises:
            DesktopError: the disk is full.

        """
        note = f"patch-{old[7:39]}-{new[7:39]}"
        with self._lock:
            if known := self._known(note):
                return known
            with self._cache.unpacked(old) as before, self._cache.unpacked(new) as after:
                if before is None or after is None:
                    return None
                digest, size = self._cache.keep(lambda out: patch_format.make(before, after, out))
            self._cache.note(note, json.dumps([digest, size]))
            return Upload(digest=digest, size=size)

    def _known(self, note: str) -> Upload | None:
        with contextlib.suppress(OSError, ValueError):
            digest, size = json.loads(self._cache.noted(note))
            if self._cache.size(digest) == size:
                return Upload(digest=digest, size=size)
        return None
