from __future__ import annotations

import errno
import hashlib
import os
import shutil
import stat
import subprocess
import tarfile
from typing import TYPE_CHECKING

import pytest

from fleet.bundle import write
from fleet.bundle.write import SUMS, Writer, parts, piece, write_tar
from fleet.errors import DesktopError, UsageError
from tests.support.bundles import bundle, opened

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

LATER = "2026-11-29T12:00:00Z"


def files(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def sound(folder: Path) -> bool:
    """As a person checks it."""
    command = ("sha256sum", "--check", "--strict", "--quiet", SUMS)
    return subprocess.run(command, cwd=folder, capture_output=True, check=False).returncode == 0


def test_a_bundle_is_written_whole_and_the_second_time_only_what_is_new(tmp_path: Path) -> None:
    """Nothing of the one before stays that is not needed, and other files are left alone."""
    (tmp_path / "holiday.jpg").write_text("mine")
    _, pieces = bundle()
    first = Writer(tmp_path).write(pieces)
    assert (first.files, first.kept) == (len(pieces), 0)
    assert files(tmp_path) == {one.path for one in pieces} | {SUMS, "holiday.jpg"}
    assert sound(tmp_path)
    again = Writer(tmp_path).write(pieces)
    assert (again.files, again.new, again.kept) == (0, 0, first.new)
    _, pieces = bundle("pi1", made=LATER)
    other = Writer(tmp_path).write(pieces)
    assert other.files == 2  # index and READ-ME.txt
    assert files(tmp_path) == {one.path for one in pieces} | {SUMS, "holiday.jpg"}
    assert sound(tmp_path)


def test_a_file_that_was_edited_is_written_again(tmp_path: Path) -> None:
    """Also if its size is the same: sticks lose bits."""
    _, pieces = bundle()
    Writer(tmp_path).write(pieces)
    path = next((tmp_path / "layers").iterdir())
    data = bytearray(path.read_bytes())
    data[100] ^= 1
    path.write_bytes(data)
    assert not sound(tmp_path)
    assert Writer(tmp_path).write(pieces).files == 1
    assert sound(tmp_path)


@pytest.mark.parametrize("failing", range(1, 6))
def test_a_stick_that_is_pulled_out_keeps_the_bundle_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing: int
) -> None:
    """And the next run goes on: what was written whole is kept."""
    Writer(tmp_path).write(bundle("pi1")[1])
    before = (tmp_path / SUMS).read_text()
    _, pieces = bundle("pi1", "pi2", "pi3", made=LATER)
    fail_at(monkeypatch, failing, errno.EIO)
    with pytest.raises(DesktopError, match="put it in again; run the same command again"):
        Writer(tmp_path).write(pieces)
    monkeypatch.undo()
    assert (tmp_path / SUMS).read_text() == before
    listed = {line.split()[1]: line.split()[0] for line in before.splitlines()}
    for name in listed.keys() - {"READ-ME.txt"}:  # which no program reads
        assert hashlib.sha256((tmp_path / name).read_bytes()).hexdigest() == listed[name], name
    (tmp_path / "layers" / f"{'0' * 64}.01.part").write_text("cut")
    Writer(tmp_path).write(pieces)
    assert sound(tmp_path)
    assert files(tmp_path) == {one.path for one in pieces} | {SUMS}


def fail_at(monkeypatch: pytest.MonkeyPatch, count: int, code: int) -> None:
    """Let the n-th file that is written be one that cannot be synced."""
    sync, left = os.fsync, [count]

    def broken(handle: int) -> None:
        left[0] -= stat.S_ISREG(os.fstat(handle).st_mode)
        if left[0] == 0:
            raise OSError(code, os.strerror(code))
        sync(handle)

    monkeypatch.setattr(os, "fsync", broken)


@pytest.mark.parametrize(
    ("code", "words"),
    [(errno.ENOSPC, "is full"), (errno.EROFS, "write-protected"), (errno.ENODEV, "pulled out")],
)
def test_a_stick_that_refuses_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int, words: str
) -> None:
    """What happened, and what to do."""
    fail_at(monkeypatch, 1, code)
    with pytest.raises(DesktopError, match=words):
        Writer(tmp_path).write(bundle()[1])
    assert not list(tmp_path.rglob("*.part"))


def test_room_is_checked_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With what the bundle before takes; nothing is written."""
    usage = shutil._ntuple_diskusage(10**9, 10**9 - 5000, 5000)  # noqa: SLF001
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    with pytest.raises(DesktopError, match=r"has 5\.0 kB free, and the bundle needs .*a larger stick"):
        Writer(tmp_path).write(bundle()[1])
    assert files(tmp_path) == set()


def test_a_folder_must_be_there_and_ours(tmp_path: Path) -> None:
    """A stick that is not mounted, and somebody's file of the same name."""
    with pytest.raises(UsageError, match=r"there is no folder .*mount the stick"):
        Writer(tmp_path / "STICK").write(bundle()[1])
    (tmp_path / "install").write_text("#!/bin/sh\nmine\n")
    with pytest.raises(UsageError, match="is not a file of fleet"):
        Writer(tmp_path).write(bundle()[1])
    assert files(tmp_path) == {"install"}


def test_a_large_layer_comes_in_parts(tmp_path: Path) -> None:
    """FAT32 has no files of more than 4 GiB."""
    whole, _ = bundle()
    blob = next(iter(whole.layers.values()))
    source: Callable[[], object] = lambda: opened(blob.hex)  # noqa: E731
    pieces = parts("layers/x", size=blob.size, digest=blob.hex, source=source, most=15_000)  # type: ignore[arg-type]
    assert [one.path for one in pieces] == ["layers/x.01", "layers/x.02", "layers/x.03"]
    Writer(tmp_path).write(pieces)
    together = b"".join((tmp_path / one.path).read_bytes() for one in pieces)
    assert together == opened(blob.hex).read()
    assert sound(tmp_path)
    assert write.PART < 4 * 1024**3


def test_a_signature_lies_beside_the_list_that_it_is_of(tmp_path: Path) -> None:
    """An older one goes."""
    for data in (b"a", b"b"):
        Writer(tmp_path).write([piece("READ-ME.txt", data)], sign=lambda text: text[:4])
    (signature,) = tmp_path.glob("signed-*.sig")
    assert signature.read_bytes() == (tmp_path / SUMS).read_bytes()[:4]
    Writer(tmp_path).write([piece("READ-ME.txt", b"b")])
    assert not list(tmp_path.glob("signed-*.sig"))


def test_a_key_that_does_not_sign_costs_nothing(tmp_path: Path) -> None:
    """The bundle before stays, and nothing of the new one is written."""
    Writer(tmp_path).write(bundle("pi1")[1])
    before = {name: (tmp_path / name).read_bytes() for name in files(tmp_path)}

    def refuse(_: bytes) -> bytes:
        raise UsageError("no-key did not sign")

    with pytest.raises(UsageError, match="did not sign"):
        Writer(tmp_path).write(bundle("pi1", "pi2", made=LATER)[1], sign=refuse)
    assert {name: (tmp_path / name).read_bytes() for name in files(tmp_path)} == before


def test_what_was_cut_off_counts_as_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is removed before anything is written; a full stick would never get out of that otherwise."""
    (tmp_path / "layers").mkdir()
    part = tmp_path / "layers" / f"{'0' * 64}.01.part"
    part.write_bytes(bytes(2_000_000))
    usage = shutil._ntuple_diskusage(10**9, 10**9 - 5000, 5000)  # noqa: SLF001
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    Writer(tmp_path).write(bundle()[1])
    assert not part.exists()


def test_a_bundle_can_be_one_file(tmp_path: Path) -> None:
    """As CI keeps it. Only its owner reads it, because secrets are in it."""
    (tmp_path / "b.tar").write_text("an older one")
    written = write_tar(tmp_path / "b.tar", lambda folder: Writer(folder).write(bundle()[1]))
    assert written.files == len(bundle()[1])
    assert [path.name for path in tmp_path.iterdir()] == ["b.tar"]
    assert (tmp_path / "b.tar").stat().st_mode & 0o777 == 0o600
    with pytest.raises(UsageError, match="there is no folder"):
        write_tar(tmp_path / "no/b.tar", lambda _: written)


@pytest.mark.parametrize("failing", range(1, 9))
def test_one_file_that_is_interrupted_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing: int
) -> None:
    """Ctrl-C while files are written, or while they are put into the archive."""
    (tmp_path / "b.tar").write_text("an older one")
    left, add = [failing], tarfile.TarFile.add

    def interrupted(archive: tarfile.TarFile, *arguments: object, **values: object) -> None:
        left[0] -= 1
        if left[0] == 0:
            raise KeyboardInterrupt
        add(archive, *arguments, **values)  # type: ignore[arg-type]

    monkeypatch.setattr(tarfile.TarFile, "add", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_tar(tmp_path / "b.tar", lambda folder: Writer(folder).write(bundle()[1]))
    assert [path.name for path in tmp_path.iterdir()] == ["b.tar"]
    assert (tmp_path / "b.tar").read_text() == "an older one"
