from __future__ import annotations

import re
from pathlib import Path

import pytest

from fleet import onboard
from fleet.robot import paths

FLEET = Path(onboard.__file__).parents[1]
SCRIPTS = sorted(path.name for path in (FLEET / "onboard").glob("*.sh") if ".fleet" in path.read_text())


def test_each_stack_has_a_place_of_its_own() -> None:
    """Below fleet's own in the login's home; data lies outside of every release."""
    assert paths.stack("nav") == f"{paths.HOME}/stacks/nav"
    assert paths.folder("nav", "abc") == f"{paths.stack('nav')}/releases/abc"
    assert paths.data("nav") == f"{paths.stack('nav')}/data"


def test_there_are_scripts_that_name_the_places() -> None:
    """Else the next test would be about nothing."""
    assert {"probe.sh", "swap.sh", "adopt.sh", "remove_releases.sh", "remove_stack.sh"} <= set(SCRIPTS)


@pytest.mark.parametrize("name", SCRIPTS)
def test_scripts_use_the_same_places(name: str) -> None:
    """They run on the robot, where nothing can be imported; the table of the module's docstring has them all."""
    script = re.sub(r"^ *#.*", "", onboard.text(name), flags=re.MULTILINE)
    places = set(re.findall(r"(?<![\w/])(?:\$HOME\"?/)?\.fleet/([a-z]+)", script))
    known = set(re.findall(r"^    ([a-z]+)\b", paths.__doc__ or "", flags=re.MULTILINE))
    # An older fleet kept one stack's releases directly in its home.
    assert places <= known | {"holder"} | {"releases", "current"}


def test_a_half_written_release_ends_as_the_probe_expects() -> None:
    """The script that writes it and the parser that ignores it agree."""
    assert f"$1.$${paths.PART}" in onboard.text("unpack_release.sh")


def test_the_state_directory_is_named_in_one_module() -> None:
    """Everything else takes it from there, but for sentences that people read and scripts that run on robots."""
    literal = re.compile(r"""["']\.fleet\b""")
    named = {
        str(path.relative_to(FLEET))
        for path in FLEET.rglob("*.py")
        if literal.search(path.read_text(encoding="utf-8"))
    }
    assert named == {"robot/paths.py"}
