"""How does a robot make a layer's tar of one it has? With a patch, or as a whole copy, and it proves what it made.

Standard library only, and good for Python 3.8 and for Debian's python3-minimal, which lacks gzip, shutil and tempfile:
this file is sent to robots and runs there by itself, twice, so that the new layer is never written to the SD card::

    sudo -n python3 rebuild_layer.py --chain sha256:... --patch FILE --check sha256:WANTED
    sudo -n python3 rebuild_layer.py --chain sha256:... --patch FILE sha256:WANTED | ...

The old layer is read where it lies. The new one's last bytes are held back until its digest is right.
"""

from __future__ import annotations

import argparse
import base64
import contextlib
import hashlib
import json
import os
import re
import struct
import subprocess
import sys
import threading
import zlib
from array import array
from bisect import bisect_right
from pathlib import Path
from typing import IO, TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

UNUSABLE, MISSING, BROKEN = 65, 69, 74  # exit codes: see `fleet.transfer.rebuild_command`
MAGIC = "fleet-patch 1"
HEADER = struct.Struct(
    ">QIII"
)  # old offset, old length, new length, packed length: see `fleet.transfer.patch_format`
SEGMENT, RANGE = 24 << 20, 32 << 20  # bytes; a patch that asks for more would need too much memory
SHARED_MEMORY, SPARE = "/dev/shm", 8 * RANGE  # noqa: S108 - no file has a name there: see `scratch`
CHUNK = 1 << 20


class Problem(Exception):
    """Why these bytes do not make that layer."""


class Layer:
    """An old layer's tar, in pieces that are read where they lie: paths of files, and short bytes packed by zlib."""

    def __init__(self) -> None:
        self.size = 0
        self._starts = array("Q", [0])  # of each piece, and at last of the end
        self._pieces: list[bytes | str] = []

    def add(self, piece: bytes | str, size: int) -> None:
        """Go on with so many bytes."""
        if size:
            self.size += size
            self._pieces.append(piece)
            self._starts.append(self.size)

    def read(self, start: int, count: int) -> Iterator[bytes]:
        """Yield so many bytes from there on. Raises `Problem` where a file is not as it was."""
        end = start + count
        for index in range(bisect_right(self._starts, start) - 1, len(self._pieces)):
            first, last = self._starts[index], self._starts[index + 1]
            if first >= end:
                return
            skip, stop = max(0, start - first), min(end, last) - first
            piece = self._pieces[index]
            if isinstance(piece, bytes):
                yield zlib.decompress(piece)[skip:stop]
            else:
                yield from part(piece, skip, stop - skip)


def part(path: str, start: int, count: int) -> Iterator[bytes]:
    """Yield so many bytes of a file. Raises `Problem` where there are fewer."""
    try:
        with open(path, "rb") as file:  # noqa: PTH123 - a Path each for 100,000 files needs memory
            file.seek(start)
            while count and (piece := file.read(min(count, CHUNK))):
                count -= len(piece)
                yield piece
    except (FileNotFoundError, NotADirectoryError) as problem:
        raise Problem(f"the old layer has lost {path}") from problem
    if count:
        raise Problem(f"{path} is shorter than it was")


def from_chain(chain: str, root: Path) -> Layer:
    """Open a layer of a classic overlay2 store by its chain ID (hex). Raises `Problem`.

    tar-split has kept a JSON object a line, of type 1 for a file's content, 2 for bytes that are in no file.
    """
    about, layer = root / "image/overlay2/layerdb/sha256" / chain, Layer()
    directory = root / "overlay2" / (about / "cache-id").read_text(encoding="ascii").strip() / "diff"
    with (about / "tar-split.json.gz").open("rb") as file:
        try:
            for entry in map(json.loads, lines_of(inflated(file))):
                if entry["type"] == 2:
                    bare = base64.b64decode(entry.get("payload") or "")
                    layer.add(zlib.compress(bare, 1), len(bare))
                else:
                    raw = base64.b64decode(entry.get("name_raw") or "") or os.fsencode(entry["name"])
                    # As if its directory were the root: ``..`` leads nowhere else.
                    inside = os.path.normpath("/" + os.fsdecode(raw)).lstrip("/")
                    layer.add(f"{directory}/{inside}", int(entry.get("size") or 0))
        except (ValueError, KeyError, TypeError) as problem:
            raise Problem(f"{about}/tar-split.json.gz cannot be read: {problem}") from problem
    return layer


def inflated(file: IO[bytes]) -> Iterator[bytes]:
    """Yield what a gzip file contains, piece by piece. Raises `Problem`."""
    inflate, rest = zlib.decompressobj(31), file.read(CHUNK)
    try:
        while rest:
            if inflate.eof:  # some programs pack a file in several parts
                inflate = zlib.decompressobj(31)
            yield inflate.decompress(rest, CHUNK)
            rest = (inflate.unused_data if inflate.eof else inflate.unconsumed_tail) or file.read(CHUNK)
        yield inflate.flush()
    except zlib.error as problem:
        raise Problem(f"what gzip has packed cannot be unpacked: {problem}") from problem
    if not inflate.eof:
        raise Problem("what gzip has packed ends early")


def lines_of(pieces: Iterable[bytes]) -> Iterator[bytes]:
    """Yield the lines of what comes in pieces; each ends with a line feed."""
    rest = b""
    for piece in pieces:
        *lines, rest = (rest + piece).split(b"\n")
        yield from lines


def from_file(paths: list[str], directory: Path) -> Layer:
    """Open the first of these that exists. What is packed is unpacked into ``directory``, as ranges may go back."""
    layer, path = Layer(), next(filter(os.path.exists, paths), paths[-1])
    size = Path(path).stat().st_size
    with Path(path).open("rb") as file:
        first = file.read(4)
        file.seek(0)
        if first[:2] == b"\x1f\x8b" or first == b"\x28\xb5\x2f\xfd":
            with scratch(directory) as whole:
                for piece in inflated(file) if first[:2] == b"\x1f\x8b" else unzstd(file, size):
                    whole.write(piece)
                size = whole.tell()
                # A descriptor that stays open until this program ends.
                path = f"/proc/self/fd/{os.dup(whole.fileno())}"
    layer.add(path, size)
    return layer


def scratch(directory: Path) -> IO[bytes]:
    """Make a file there that has no name any more, so that nothing is left of it however this program ends."""
    path = directory / f".rebuild-{os.urandom(8).hex()}"
    made = path.open("x+b")
    path.unlink()
    return made


def lies(directory: Path) -> Path:
    """Where a range lies while zstd refers to it: in memory where `SPARE` bytes are free, to spare the SD card."""
    try:
        room = os.statvfs(SHARED_MEMORY)
        said = re.search("MemAvailable: *([0-9]+) kB", Path("/proc/meminfo").read_text(encoding="ascii"))
    except OSError:
        return directory
    plenty = said and int(said[1]) * 1024 > SPARE and room.f_bavail * room.f_frsize > RANGE + CHUNK
    return Path(SHARED_MEMORY) if plenty else directory


def unzstd(packed: IO[bytes], count: int, *, against: IO[bytes] | None = None) -> Iterator[bytes]:
    """Yield what the next ``count`` bytes of a file unpack to. Raises `Problem`, after the last piece."""
    pipe, quiet = subprocess.PIPE, subprocess.DEVNULL
    command, inherit = ["zstd", "-dqc", "--memory=128MB"], []
    if against:
        against.flush()
        inherit = [against.fileno()]
        # Not --patch-from, which does the same: Ubuntu 20.04 has zstd 1.4.4, and that came with 1.4.5.
        command += ["-D", f"/proc/self/fd/{against.fileno()}"]
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=quiet, pass_fds=inherit) as zstd:
        feeding = threading.Thread(target=feed, args=(zstd.stdin, packed, count), daemon=True)
        feeding.start()
        try:
            yield from iter(lambda: zstd.stdout.read(CHUNK), b"")  # type: ignore[union-attr]  # it is a pipe
        finally:
            zstd.stdout.close()  # type: ignore[union-attr]
            feeding.join()
    if zstd.returncode:
        raise Problem("zstd cannot unpack it: it is damaged, or made for another old layer")


def feed(pipe: IO[bytes], packed: IO[bytes], count: int) -> None:
    """Write so many bytes of a file, as far as it goes, to a program that may end before."""
    with contextlib.suppress(BrokenPipeError), pipe:
        while count and (piece := packed.read(min(count, 1 << 16))):
            pipe.write(piece)
            count -= len(piece)


def rebuilt(old: Layer, patch: IO[bytes], directory: Path) -> Iterator[bytes]:
    """Yield the new layer, segment by segment. Raises `Problem`."""
    head = re.fullmatch(MAGIC + " ([0-9]{1,18}) ([0-9]{1,18})\n", patch.readline(80).decode("latin-1"))
    if not head:
        raise Problem("the patch is none, or of another version of fleet")
    if int(head[1]) != old.size:
        raise Problem(f"the patch is for an old layer of {head[1]} bytes, and this one has {old.size}")
    left = int(head[2])
    while left:
        header = patch.read(HEADER.size)
        if len(header) < HEADER.size:
            raise Problem("the patch ends early")
        start, length, new_length, packed = HEADER.unpack(header)
        if not 0 < new_length <= min(SEGMENT, left) or length > RANGE or start + length > old.size:
            raise Problem("the patch is damaged: it asks for what cannot be")
        left -= new_length
        pieces = old.read(start, length)
        for piece in unpacked(pieces, patch, packed, directory) if packed else pieces:
            new_length -= len(piece)
            if new_length < 0:
                break
            yield piece
        if new_length:
            raise Problem("the patch is damaged: a segment has another length")
    if patch.read(1):
        raise Problem("the patch goes on after its end")


def unpacked(old: Iterator[bytes], patch: IO[bytes], count: int, directory: Path) -> Iterator[bytes]:
    """Yield what the next ``count`` bytes of the patch say of an old range. Raises `Problem`."""
    with scratch(lies(directory)) as reference:
        for piece in old:
            reference.write(piece)
        yield from unzstd(patch, count, against=reference if reference.tell() else None)


def deliver(pieces: Iterable[bytes], wanted: str, out: IO[bytes]) -> None:
    """Write a layer whose SHA-256 is wanted; its last piece only when that is right. Raises `Problem`."""
    made, held = hashlib.sha256(), b""
    for piece in filter(None, pieces):
        made.update(piece)
        out.write(held)
        held = piece
    if made.hexdigest() != wanted:
        raise Problem(f"what was made is sha256:{made.hexdigest()}, not sha256:{wanted}")
    out.write(held)
    out.flush()


def new_layer(asked: argparse.Namespace) -> Iterator[bytes]:
    """Open what the command line names, and yield the new layer. Raises `Problem` or `OSError`."""
    old = from_chain(asked.chain, asked.root) if asked.chain else from_file(asked.file, asked.scratch)
    if asked.patch:
        with asked.patch.open("rb") as patch:
            yield from rebuilt(old, patch, asked.scratch)
    else:
        yield from old.read(0, old.size)


def digest(said: str) -> str:
    """Return the hex digits of a digest, which become part of a path."""
    if not re.fullmatch("sha256:[0-9a-f]{64}", said):
        raise argparse.ArgumentTypeError(f"{said} is no digest of the form sha256:...")
    return said[7:]


def main() -> int:
    """Make the layer that the command line asks for; return the exit code, with a sentence on standard error."""
    options = argparse.ArgumentParser(description="Make a layer's tar of one that is here, and prove it.")
    options.add_argument("wanted", type=digest, help="the new layer's diff ID")
    old = options.add_mutually_exclusive_group(required=True)
    old.add_argument("--chain", type=digest, help="the old layer's chain ID in a classic overlay2 store")
    old.add_argument("--file", action="append", help="its tar, plain or packed; several: whichever exists")
    options.add_argument("--root", type=Path, default="/var/lib/docker", help="Docker's data root")
    options.add_argument("--patch", type=Path, help="without one, the old layer itself is wanted")
    options.add_argument("--scratch", type=Path, default=".", help="a directory for temporary files")
    options.add_argument("--check", action="store_true", help="write nothing")
    asked = options.parse_args()
    try:
        out = Path(os.devnull).open("wb") if asked.check else sys.stdout.buffer  # noqa: SIM115 - ends with the program
        deliver(new_layer(asked), asked.wanted, out)
    except Problem as problem:
        said, code = str(problem), UNUSABLE
    except OSError as problem:
        said = f"{problem.filename or 'reading or writing'}: {problem.strerror}"
        code = MISSING if isinstance(problem, (FileNotFoundError, PermissionError)) else BROKEN
    else:
        return 0
    sys.stderr.write(said + "\n")
    # What Python would still write at its end goes nowhere: the reader may be gone.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return code


if __name__ == "__main__":
    sys.exit(main())
