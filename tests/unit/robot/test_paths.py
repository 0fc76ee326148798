from __future__ import annotations

import re
from pathlib import Path

import pytest

from fleet import onboard
from fleet.robot import paths

FLEET = Path(onboard.__file__).parents[1]
SCRIPTS = ("probe.sh", "unpack_release.sh", "start_release.sh", "note_history.sh")


def test_a_release_has_a_directory_of_its_own() -> None:
    """Below fleet's own in the login's home, where every command starts."""
    assert paths.folder("abc") == f"{paths.HOME}/releases/abc"


@pytest.mark.parametrize("name", SCRIPTS)
def test_scripts_use_the_same_directories(name: str) -> None:
    """They run on the robot, where nothing can be imported."""
    script = onboard.text(name)
    places = set(
        re.findall(
            r"(?<![\w/])(?:\$HOME\"?/)?(\.\w+)/(\w+)", re.sub(r"^ *#.*", "", script, flags=re.MULTILINE)
        )
    )
    known = {"releases", "current", "history", "receipts", "spool", "lock"}
    assert {home for home, _ in places} <= {paths.HOME}
    assert {place for _, place in places} <= known
    assert paths.HOME in script or paths.PART in script


def test_a_half_written_release_ends_as_the_probe_expects() -> None:
    """The script that writes it and the parser that ignores it agree."""
    assert f"$1.$${paths.PART}" in onboard.text("unpack_release.sh")
    assert f"*{paths.PART}" in onboard.text("unpack_release.sh")


def test_the_state_directory_is_named_in_one_module() -> None:
    """Everything else takes it from there, but for sentences that people read and scripts that run on robots."""
    literal = re.compile(r"""["']\.fleet\b""")
    named = {
        str(path.relative_to(FLEET))
        for path in FLEET.rglob("*.py")
        if literal.search(path.read_text(encoding="utf-8"))
    }
    assert named == {"robot/paths.py"}
