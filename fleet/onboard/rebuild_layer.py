"""Rebuild the tar of a layer on a robot from a layer that the robot has, with a patch or as a copy, and prove it.

This file is sent to robots and runs there without any other file. It uses only what Python 3.8 and Debian's python3-minimal
have, which lacks gzip, shutil and tempfile. It runs twice, so that the new layer is never written to the SD card::

    sudo -n python3 rebuild_layer.py --chain sha256:... --patch FILE --check sha256:WANTED
    sudo -n python3 rebuild_layer.py --chain sha256:... --patch FILE sha256:WANTED | ...

The old layer is read in place. The last bytes of the new one are written only after its digest is proved.
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

UNUSABLE, MISSING, BROKEN_OFF = 65, 69, 74  # see `fleet.onboard.exit_codes`; this file must stand alone
MAGIC = "fleet-patch 1"
HEADER = struct.Struct(
    ">QIII"
)  # old offset, old length, new length, packed length: see `fleet.transfer.patch_format`
SEGMENT, RANGE = 24 << 20, 32 << 20  # bytes; a patch with larger ones would need too much memory
SHARED_MEMORY, SPARE = "/dev/shm", 8 * RANGE  # noqa: S108 - files there have no name: see `scratch`
CHUNK = 1 << 20


class Problem(Exception):
    """The layer cannot be rebuilt: the old layer or the patch is damaged, or they do not match."""


class Layer:
    """The tar of an old layer in parts: files, given by their paths and read in place, and bytes packed with zlib."""

    def __init__(self) -> None:
        self.size = 0
        self._starts = array("Q", [0])  # the offset of each part, and finally of the end
        self._parts: list[bytes | str] = []

    def add(self, part: bytes | str, size: int) -> None:
        """Append a part of ``size`` bytes."""
        if size:
            self.size += size
            self._parts.append(part)
            self._starts.append(self.size)

    def read(self, start: int, count: int) -> Iterator[bytes]:
        """Yield ``count`` bytes from offset ``start``. Raises `Problem` if a file is missing or too short."""
        end = start + count
        for index in range(bisect_right(self._starts, start) - 1, len(self._parts)):
            first, last = self._starts[index], self._starts[index + 1]
            if first >= end:
                return
            skip, stop = max(0, start - first), min(end, last) - first
            part = self._parts[index]
            if isinstance(part, bytes):
                yield zlib.decompress(part)[skip:stop]
            else:
                yield from read_file(part, skip, stop - skip)


def read_file(path: str, start: int, count: int) -> Iterator[bytes]:
    """Yield ``count`` bytes of a file from offset ``start``. Raises `Problem` if there are fewer."""
    try:
        with open(path, "rb") as file:  # noqa: PTH123 - a Path each for 100,000 files needs memory
            file.seek(start)
            while count and (chunk := file.read(min(count, CHUNK))):
                count -= len(chunk)
                yield chunk
    except (FileNotFoundError, NotADirectoryError) as problem:
        raise Problem(f"{path} of the old layer is missing") from problem
    if count:
        raise Problem(f"{path} is shorter than it was")


def from_chain(chain: str, root: Path) -> Layer:
    """Open a layer of a classic overlay2 store by its chain ID (hex). Raises `Problem`.

    tar-split has recorded one JSON object per line: type 1 for the content of a file, type 2 for bytes outside of files.
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
                    # Resolve ``..`` as if the directory were the root, so that no path leaves it.
                    inside = os.path.normpath("/" + os.fsdecode(raw)).lstrip("/")
                    layer.add(f"{directory}/{inside}", int(entry.get("size") or 0))
        except (ValueError, KeyError, TypeError) as problem:
            raise Problem(f"{about}/tar-split.json.gz cannot be read: {problem}") from problem
    return layer


def inflated(file: IO[bytes]) -> Iterator[bytes]:
    """Yield the unpacked bytes of a gzip file in chunks. Raises `Problem`."""
    inflate, rest = zlib.decompressobj(31), file.read(CHUNK)
    try:
        while rest:
            if inflate.eof:  # some programs write several gzip streams in a row
                inflate = zlib.decompressobj(31)
            yield inflate.decompress(rest, CHUNK)
            rest = (inflate.unused_data if inflate.eof else inflate.unconsumed_tail) or file.read(CHUNK)
        yield inflate.flush()
    except zlib.error as problem:
        raise Problem(f"gzip data cannot be unpacked: {problem}") from problem
    if not inflate.eof:
        raise Problem("gzip data ends early")


def lines_of(chunks: Iterable[bytes]) -> Iterator[bytes]:
    """Yield the lines of a stream that comes in chunks; bytes after the last line feed are dropped."""
    rest = b""
    for chunk in chunks:
        *lines, rest = (rest + chunk).split(b"\n")
        yield from lines


def from_file(paths: list[str], directory: Path) -> Layer:
    """Open the first file that exists. A packed file is unpacked into ``directory``, because ranges may go back."""
    layer, path = Layer(), next(filter(os.path.exists, paths), paths[-1])
    size = Path(path).stat().st_size
    with Path(path).open("rb") as file:
        first = file.read(4)
        file.seek(0)
        if first[:2] == b"\x1f\x8b" or first == b"\x28\xb5\x2f\xfd":
            with scratch(directory) as plain:
                for chunk in inflated(file) if first[:2] == b"\x1f\x8b" else unzstd(file, size):
                    plain.write(chunk)
                size = plain.tell()
                # The descriptor stays open until this program ends.
                path = f"/proc/self/fd/{os.dup(plain.fileno())}"
    layer.add(path, size)
    return layer


def scratch(directory: Path) -> IO[bytes]:
    """Make a temporary file and remove its name, so that nothing is left however this program ends."""
    path = directory / f".rebuild-{os.urandom(8).hex()}"
    file = path.open("x+b")
    path.unlink()
    return file


def scratch_directory(directory: Path) -> Path:
    """The directory for a range that zstd refers to: in memory if `SPARE` bytes are free, to spare the SD card."""
    try:
        room = os.statvfs(SHARED_MEMORY)
        available = re.search("MemAvailable: *([0-9]+) kB", Path("/proc/meminfo").read_text(encoding="ascii"))
    except OSError:
        return directory
    plenty = available and int(available[1]) * 1024 > SPARE and room.f_bavail * room.f_frsize > RANGE + CHUNK
    return Path(SHARED_MEMORY) if plenty else directory


def unzstd(packed: IO[bytes], count: int, *, against: IO[bytes] | None = None) -> Iterator[bytes]:
    """Yield the unpacked form of the next ``count`` bytes of a file. Raises `Problem`, after the last chunk."""
    pipe, quiet = subprocess.PIPE, subprocess.DEVNULL
    command, inherit = ["zstd", "-dqc", "--memory=128MB"], []
    if against:
        against.flush()
        inherit = [against.fileno()]
        # -D does the same as --patch-from, which came with zstd 1.4.5; Ubuntu 20.04 has zstd 1.4.4.
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
        raise Problem("zstd cannot unpack the data: it is damaged, or made for another old layer")


def feed(pipe: IO[bytes], packed: IO[bytes], count: int) -> None:
    """Write up to ``count`` bytes of a file to a program, which may end before it has read them."""
    with contextlib.suppress(BrokenPipeError), pipe:
        while count and (chunk := packed.read(min(count, 1 << 16))):
            pipe.write(chunk)
            count -= len(chunk)


def rebuilt(old: Layer, patch: IO[bytes], directory: Path) -> Iterator[bytes]:
    """Yield the new layer, segment by segment. Raises `Problem`."""
    header_line = re.fullmatch(MAGIC + " ([0-9]{1,18}) ([0-9]{1,18})\n", patch.readline(80).decode("latin-1"))
    if not header_line:
        raise Problem("the file is not a patch, or of another version of fleet")
    if int(header_line[1]) != old.size:
        raise Problem(f"the patch is for an old layer of {header_line[1]} bytes, and this one has {old.size}")
    left = int(header_line[2])
    while left:
        header = patch.read(HEADER.size)
        if len(header) < HEADER.size:
            raise Problem("the patch ends early")
        start, length, new_length, packed = HEADER.unpack(header)
        if not 0 < new_length <= min(SEGMENT, left) or length > RANGE or start + length > old.size:
            raise Problem("the patch is damaged: its ranges are impossible")
        left -= new_length
        chunks = old.read(start, length)
        for chunk in unpacked(chunks, patch, packed, directory) if packed else chunks:
            new_length -= len(chunk)
            if new_length < 0:
                break
            yield chunk
        if new_length:
            raise Problem("the patch is damaged: a segment has the wrong length")
    if patch.read(1):
        raise Problem("the patch continues after its end")


def unpacked(old: Iterator[bytes], patch: IO[bytes], count: int, directory: Path) -> Iterator[bytes]:
    """Yield the segment that the next ``count`` bytes of the patch make from an old range. Raises `Problem`."""
    with scratch(scratch_directory(directory)) as reference:
        for chunk in old:
            reference.write(chunk)
        yield from unzstd(patch, count, against=reference if reference.tell() else None)


def deliver(chunks: Iterable[bytes], wanted: str, out: IO[bytes]) -> None:
    """Write a layer, and its last chunk only if the SHA-256 is ``wanted``. Raises `Problem`."""
    sha256, held = hashlib.sha256(), b""
    for chunk in filter(None, chunks):
        sha256.update(chunk)
        out.write(held)
        held = chunk
    if sha256.hexdigest() != wanted:
        raise Problem(f"the rebuilt layer is sha256:{sha256.hexdigest()}, not sha256:{wanted}")
    out.write(held)
    out.flush()


def new_layer(arguments: argparse.Namespace) -> Iterator[bytes]:
    """Open the files of the command line, and yield the new layer. Raises `Problem` or `OSError`."""
    old = (
        from_chain(arguments.chain, arguments.root)
        if arguments.chain
        else from_file(arguments.file, arguments.scratch)
    )
    if arguments.patch:
        with arguments.patch.open("rb") as patch:
            yield from rebuilt(old, patch, arguments.scratch)
    else:
        yield from old.read(0, old.size)


def digest(text: str) -> str:
    """Return the hex digits of a digest; they become part of a path."""
    if not re.fullmatch("sha256:[0-9a-f]{64}", text):
        raise argparse.ArgumentTypeError(f"{text} is not a digest of the form sha256:...")
    return text[7:]


def main() -> int:
    """Rebuild the layer that the command line names; return the exit code, and print an error on standard error."""
    options = argparse.ArgumentParser(
        description="Rebuild a layer's tar from one on this robot, and prove it."
    )
    options.add_argument("wanted", type=digest, help="the new layer's diff ID")
    old = options.add_mutually_exclusive_group(required=True)
    old.add_argument("--chain", type=digest, help="the old layer's chain ID in a classic overlay2 store")
    old.add_argument(
        "--file",
        action="append",
        help="the old layer's tar, plain or packed; of several the first that exists",
    )
    options.add_argument("--root", type=Path, default="/var/lib/docker", help="Docker's data root")
    options.add_argument("--patch", type=Path, help="without a patch the old layer is copied")
    options.add_argument("--scratch", type=Path, default=".", help="a directory for temporary files")
    options.add_argument("--check", action="store_true", help="write nothing")
    arguments = options.parse_args()
    try:
        out = Path(os.devnull).open("wb") if arguments.check else sys.stdout.buffer  # noqa: SIM115 - ends with the program
        deliver(new_layer(arguments), arguments.wanted, out)
    except Problem as problem:
        message, code = str(problem), UNUSABLE
    except OSError as problem:
        message = f"{problem.filename or 'reading or writing'}: {problem.strerror}"
        code = MISSING if isinstance(problem, (FileNotFoundError, PermissionError)) else BROKEN_OFF
    else:
        return 0
    sys.stderr.write(message + "\n")
    # Discard what Python flushes at exit: the reader may have closed the pipe.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return code


if __name__ == "__main__":
    sys.exit(main())
