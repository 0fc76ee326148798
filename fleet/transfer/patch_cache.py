"""Which patches between layers has this computer made? Each is made once, of layers that were packed here."""

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
    """Makes patches, and keeps them in the cache with the layers."""

    def __init__(self, cache: LayerCache) -> None:
        self._cache = cache
        self._turn = (
            threading.Lock()
        )  # many robots need the same one, and two layers at once are enough on the disk

    def make(self, *, old: str, new: str) -> Upload | None:
        """The patch that makes layer ``new`` of ``old`` (diff IDs); None where one of them was never packed here.

        Raises:
            DesktopError: there is no room for it.

        """
        note = f"patch-{old[7:39]}-{new[7:39]}"
        with self._turn:
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
