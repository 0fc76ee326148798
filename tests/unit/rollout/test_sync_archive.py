from __future__ import annotations

import hashlib
import io
import tarfile
from typing import TYPE_CHECKING

import pytest

from fleet.plan.watch import GONE, Change, Entry
from fleet.rollout.sync_archive import Archive, Archives

if TYPE_CHECKING:
    from pathlib import Path


def put(path: Path, *, digest: str = "old") -> Change:
    return Change(verb="put", service="node", digest=digest, place=f"/app/{path.name}", source=str(path))


def members(archive: Archive) -> dict[str, tuple[bytes, int, str]]:
    """Content, mode and target of what is in it."""
    with tarfile.open(fileobj=io.BytesIO(b"".join(archive.chunks(0)))) as tar:
        return {
            one.name: (
                file.read() if one.isfile() and (file := tar.extractfile(one)) else b"",
                one.mode,
                one.linkname,
            )
            for one in tar
        }


@pytest.fixture
def archives(tmp_path: Path) -> Archives:
    (tmp_path / "packed").mkdir()
    return Archives(tmp_path / "packed")


def test_files_and_the_plan(archives: Archives, tmp_path: Path) -> None:
    """The digest of the plan is that of the bytes that are in it, whatever was seen before; the name is the archive's own."""
    path = tmp_path / "run"
    path.write_bytes(b"#!x")
    gone = Change(verb="gone", service="node", digest=GONE, place="/app/gone")
    made = archives.of((gone, put(path)), {str(path): Entry(digest="old", mode=0o755)})
    digest = f"{hashlib.sha256(b'#!x').hexdigest()}.755"
    plan = f"gone node - /app/gone\nput node {digest} /app/run\n"
    assert members(made) == {"files/node/app/run": (b"#!x", 0o755, ""), "plan": (plan.encode(), 0o644, "")}
    data = b"".join(made.chunks(0))
    assert (made.name, made.size) == (hashlib.sha256(data).hexdigest(), len(data))
    assert b"".join(made.chunks(10)) == data[10:]
    assert made.changes == (gone, put(path, digest=digest))


def test_it_is_packed_once(archives: Archives, tmp_path: Path) -> None:
    """For all robots that lack the same; old ones are removed."""
    path = tmp_path / "a"
    path.write_bytes(b"1")
    tree = {str(path): Entry(digest="1")}
    first = archives.of((put(path),), tree)
    path.write_bytes(b"2")
    assert archives.of((put(path),), tree) is first
    for number in range(20):
        archives.of((put(path, digest=str(number)),), tree)
    assert len(list((tmp_path / "packed").iterdir())) == 8


def test_a_link_stays_one(archives: Archives, tmp_path: Path) -> None:
    """Its target is not read."""
    path = tmp_path / "link"
    path.symlink_to("nowhere")
    made = archives.of((put(path),), {str(path): Entry(digest="l", mode=0o777, link="nowhere")})
    assert members(made)["files/node/app/link"] == (b"", 0o777, "nowhere")


def test_a_file_that_is_gone_again(archives: Archives, tmp_path: Path) -> None:
    """The next look says so; until then it is an error that can be tried again."""
    with pytest.raises(OSError, match="No such file"):
        archives.of((put(tmp_path / "gone"),), {str(tmp_path / "gone"): Entry(digest="1")})
    made = archives.of((put(tmp_path / "gone"),), {})
    assert made.changes == (
        Change(verb="gone", service="node", digest=GONE, place="/app/gone", source=str(tmp_path / "gone")),
    )


def test_a_large_file_is_not_read_as_a_whole(archives: Archives, tmp_path: Path) -> None:
    """It keeps the digest that was seen."""
    path = tmp_path / "large"
    with path.open("wb") as file:
        file.truncate(50_000_000)
    made = archives.of((put(path, digest="seen"),), {str(path): Entry(digest="seen", size=50_000_000)})
    assert made.changes == (put(path, digest="seen"),)
    assert made.size < 1_000_000
