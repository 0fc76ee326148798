from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import cast

import pytest

from docs import generate

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def pages() -> dict[str, str]:
    """What `make reference` would write now, from a fresh process: Invoke forgets the flags' texts after their first use."""
    program = "import json; from docs import generate; print(json.dumps(generate.pages()))"
    line = (sys.executable, "-c", program)
    made = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, check=True)
    return cast("dict[str, str]", json.loads(made.stdout))


@pytest.mark.parametrize("name", ["verbs.md", "inventory.md", "exit-codes.md", "files-on-a-robot.md"])
def test_reference_is_current(name: str, pages: dict[str, str]) -> None:
    """docs/reference/ says what the code says today."""
    assert (generate.FOLDER / name).read_text(encoding="utf-8") == pages[name], "run: make reference"


def test_every_generated_page_is_compared(pages: dict[str, str]) -> None:
    """A new page has its line above; json.md is written by hand and compared elsewhere."""
    assert pages.keys() | {"json.md"} == {path.name for path in generate.FOLDER.glob("*.md")}
    assert len(pages) == 4


def test_every_flag_is_explained(pages: dict[str, str]) -> None:
    """A help page has a text beside each flag."""
    flags = [line for line in pages["verbs.md"].splitlines() if line.startswith("  --")]
    assert len(flags) > 50
    assert [line for line in flags if len(line.split(maxsplit=1)) < 2] == []
