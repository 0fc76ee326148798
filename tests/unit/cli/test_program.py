from __future__ import annotations

import pytest

from fleet.cli import program


@pytest.mark.parametrize(
    ("typed", "said"),
    [
        ("run `fab build`", "run `fleet build`"),
        ("fab run --hosts NAMES -- COMMAND", "fleet run --hosts NAMES -- COMMAND"),
        ("`fab --list`", "`fleet --list`"),
        ("/opt/fab ship, prefab houses, `fab`", "/opt/fab ship, prefab houses, `fab`"),
    ],
)
def test_messages_name_the_command_that_was_typed(
    monkeypatch: pytest.MonkeyPatch, typed: str, said: str
) -> None:
    """With `fleet`, a cure says `fleet`; with `fab`, it stays."""
    monkeypatch.setattr("sys.argv", ["/home/tim/.venv/bin/fleet", "ship"])
    assert (program.name(), program.typed(typed)) == ("fleet", said)
    monkeypatch.setattr("sys.argv", ["/usr/bin/fab", "ship"])
    assert (program.name(), program.typed(typed)) == ("fab", typed)
