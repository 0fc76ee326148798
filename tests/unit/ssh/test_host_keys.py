from __future__ import annotations

import subprocess
from typing import TYPE_CHECKING

import pytest

from fleet.errors import DesktopError, UsageError
from fleet.ssh import host_keys

if TYPE_CHECKING:
    from pathlib import Path


def test_a_key_that_is_made_is_a_pair(tmp_path: Path) -> None:
    """``ssh-keygen`` finds the public half in the private one."""
    private, public = host_keys.make("root@pi7")
    path = tmp_path / "key"
    path.write_text(private)
    path.chmod(0o600)
    argv = ("ssh-keygen", "-y", "-f", str(path))
    half = subprocess.run(argv, capture_output=True, text=True, check=True).stdout
    assert half.split()[:2] == public.split()[:2]
    assert public.endswith(" root@pi7")
    shown = subprocess.run(
        ("ssh-keygen", "-lf", str(path)), capture_output=True, text=True, check=True
    ).stdout
    assert host_keys.parse(public).fingerprint in shown


def test_who_may_log_in(tmp_path: Path) -> None:
    """Each key once, private or public file; files that hold none are left out."""
    private, public = host_keys.make("me")
    (tmp_path / "id").write_text(private)
    (tmp_path / "agent.pub").write_text(public)
    (tmp_path / "broken").write_text("nothing")
    files = [tmp_path / name for name in ("broken", "id", "agent.pub", "missing")]
    (line,) = host_keys.authorized(files, comment="me@desktop")
    assert line == f"{' '.join(public.split()[:2])} me@desktop"
    with pytest.raises(UsageError, match="no SSH key to log in with"):
        host_keys.authorized(files[:1], comment="me")


def test_without_openssh(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(DesktopError, match="ssh-keygen"):
        host_keys.make("root@pi7")
