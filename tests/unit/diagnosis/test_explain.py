from __future__ import annotations

import subprocess
import time
from typing import TYPE_CHECKING

import pytest

from fleet.diagnosis import explain

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize(
    ("output", "last"),
    [
        ("", ""),
        ("\n \n", ""),
        ("first\nthe reason.\n\n", "the reason"),
        ("the reason\n+ sh -c apt-get update\nW: a warning\nSee 'docker run --help'.\n", "the reason"),
        ("the reason\nsudo: unable to resolve host pi1: Name or service not known", "the reason"),
        ("W: only a warning", "W: only a warning"),
        ("\x1b[31mred\x1b[0m\trobot", "[31mred [0m robot"),
    ],
)
def test_unknown_output_ends_in_its_own_last_words(output: str, last: str) -> None:
    """What is not known is not guessed; noise is left out where there is more."""
    assert explain.explain(output) == (last, "")


def test_long_lines_are_cut() -> None:
    """A person reads a sentence, not a page."""
    what, _ = explain.explain("x" * 5000)
    assert (len(what), what[-1]) == (300, "…")


def test_braces_in_output_are_only_text() -> None:
    """Values from a robot never become a format."""
    assert explain.explain("yaml: line 2: {0.__class__}")[0].endswith("{0.__class__}")


@pytest.mark.parametrize(
    "word", ["unknown flag: ", "memory cgroup ", "services.", "iptables ", "x", "Bind for ", "sh: "]
)
def test_endless_output_is_read_quickly(word: str) -> None:
    """A verbose tool prints a megabyte, in one line."""
    started = time.process_time()
    explain.explain(word * (1_000_000 // len(word)))
    assert time.process_time() - started < 5


def test_real_shells_are_understood(tmp_path: Path) -> None:
    """The desktop's own tools, run."""
    for argv in (
        ("sh", "-c", "nosuchcommand"),
        ("bash", "-c", "nosuchcommand"),
        ("timeout", "5", "nosuchcommand"),
    ):
        done = subprocess.run(
            argv,
            capture_output=True,
            text=True,
            check=False,
            env={"LC_ALL": "C", "PATH": "/usr/bin:/bin"},
            cwd=tmp_path,
        )
        assert explain.explain(done.stderr) == ("nosuchcommand is not installed", "")
