from __future__ import annotations

from pathlib import Path

import pytest

from fleet.config import compose_wording, yamlfile
from fleet.errors import ComposeError

TEXT = "services:\n  node:\n    image: x\n    ports: ['99999:1']  # sentry\n"


@pytest.mark.parametrize(
    ("said", "plain"),
    [
        ("services.node additional properties 'x' not allowed", "services.node: there is no such key"),
        ("open a.env: no such file or directory", "`a.env`: no such file"),
        ("invalid hostPort: 99999", "`99999` is not a port of the host"),
        ("words that  nobody\nknows", "words that nobody knows"),
    ],
)
def test_a_sentence(said: str, plain: str) -> None:
    """What is not known stays as it is, on one line."""
    assert compose_wording.sentence(said).startswith(plain.partition(":")[0])
    assert compose_wording.cure_of(compose_wording.sentence(said))


@pytest.mark.parametrize(
    ("message", "line"),
    [
        ("services.node.ports.0: bad", 4),
        ('service "node" is odd', 2),
        ("`99999` is not a port", 4),
        ("what", 0),
    ],
)
def test_the_line(message: str, line: int) -> None:
    """Of the key that is named, or else of the word that is quoted; none if nothing is known."""
    document = yamlfile.parse(TEXT, path=Path("c.yaml"), error=ComposeError)[0]
    assert compose_wording.place_of(message, [document]) == (f"c.yaml:{line}" if line else "")
