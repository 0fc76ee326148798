"""`make bench-build`: what is timed, and what is not."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bench import compiling
from bench.compiling import Bench
from bench.pairs import Cost

if TYPE_CHECKING:
    from pathlib import Path

    import pytest


def test_what_lies_below_is_built_before_the_timing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Under emulation it takes most of the time, once for all packages; and each round begins with an empty cache."""
    built: list[tuple[str, ...]] = []

    def build(_: Bench, way: str, *flags: str, cache: int = 0) -> Cost:
        built.append((way, *flags, str(cache)))
        return Cost(seconds={"cross": 5, "emulated": 50}[way] if "packages" in flags else 1000, cpu=0)

    monkeypatch.setattr(Bench, "build", build)
    monkeypatch.setattr(compiling, "docker_or_none", lambda *_: None)
    rows = compiling.measure(folder=tmp_path, say=lambda _: None)
    assert built[:5] == [
        ("cross", "--no-cache", "0"),
        *((way, "--target", stage, "0") for way in ("cross", "emulated") for stage in ("tools", "sysroot")),
    ]
    timed = [(way, flags[-1]) for way, *flags in built[5:]]
    assert timed == [(way, cache) for cache in ("1", "1", "1") for way in ("cross", "emulated")]
    assert [(row.value, row.met) for row in rows] == [(0.1, True), (0.1, True), (1000, True)]
    page = compiling.page(rows, when="today", machine="The computer.")
    assert "| Compiling, cross beside emulated | 0.10x | at most 0.20x | yes |" in page
    assert "| From nothing, cross | 1000.00 s |" in page
