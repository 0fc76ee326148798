from __future__ import annotations

import ast
import base64
import gzip
import hashlib
import io
import json
import os
import subprocess
import sys
import tarfile
from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fleet.onboard import exit_codes, rebuild_layer
from fleet.transfer import patch_format, rebuild_command
from tests.support.layers import made, noise, segments, tar

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

CHAIN = "sha256:" + "c" * 64

OLD = tar({f"usr/lib/{number}": noise(number, 300_000) for number in range(10)} | {"empty": b""})
NEW = tar({f"usr/lib/{number}": noise(number, 300_000) + b"!" for number in range(9)} | {"new": b"new"})
PATCH = made(OLD, NEW)


def diff_id(layer: bytes) -> str:
    return f"sha256:{hashlib.sha256(layer).hexdigest()}"


def ran(*arguments: str, path: str | None = None) -> subprocess.CompletedProcess[bytes]:
    """Run the program as robots do: alone, without site packages."""
    environment = os.environ | ({"PATH": path} if path is not None else {})
    command = (sys.executable, "-IS", rebuild_layer.__file__, *arguments)
    return subprocess.run(command, capture_output=True, timeout=60, check=False, env=environment)


class Robot:
    """A directory with an old layer, a patch, and a place for temporary files."""

    def __init__(self, directory: Path) -> None:
        self.old, self.patch, self.scratch = (directory / name for name in ("old", "patch", "scratch"))
        self.scratch.mkdir()
        self.old.write_bytes(OLD)
        self.patch.write_bytes(PATCH)

    def run(
        self, *, old: tuple[str, ...] = (), wanted: bytes = NEW, check: bool = False, patch: bool = True
    ) -> subprocess.CompletedProcess[bytes]:
        """Run the desktop's own command line for it."""
        _, _, _, *arguments = rebuild_command.argv(
            rebuild_layer.__file__,
            old or rebuild_command.from_files(str(self.old)),
            wanted=diff_id(wanted),
            patch=str(self.patch) if patch else "",
            scratch=str(self.scratch),
            check=check,
        )
        return ran(*arguments)

    def refuses(self, code: int, **asked: bytes) -> str:
        """It says one sentence with that exit code, whether it checks or writes, and writes nothing whole."""
        checked, written = self.run(check=True, **asked), self.run(check=False, **asked)  # type: ignore[arg-type]
        assert (checked.returncode, written.returncode) == (code, code), checked.stderr + written.stderr
        assert checked.stdout == b""
        assert len(written.stdout) < len(NEW)
        assert checked.stderr == written.stderr
        assert checked.stderr.count(b"\n") == 1
        assert list(self.scratch.iterdir()) == []
        return checked.stderr.decode()


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    return Robot(tmp_path)


def test_a_patched_layer_is_written(robot: Robot) -> None:
    """Byte for byte, and nothing else is left anywhere."""
    done = robot.run()
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout == NEW
    assert list(robot.scratch.iterdir()) == []


def test_checking_writes_nothing(robot: Robot) -> None:
    """The exit code is all."""
    done = robot.run(check=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")


def test_without_a_patch_the_layer_itself_is_proved(robot: Robot) -> None:
    """A layer that only moved to another place in the chain is a copy."""
    assert robot.run(patch=False, wanted=OLD).stdout == OLD
    assert robot.run(patch=False, wanted=NEW).returncode == exit_codes.UNUSABLE


@pytest.mark.parametrize("pack", ["gzip", "pigz", "zstd"])
def test_a_packed_old_layer_is_unpacked_first(robot: Robot, pack: str) -> None:
    """A containerd store keeps blobs as they came; some programs pack them in several parts."""
    packers: dict[str, Callable[[bytes], bytes]] = {
        "gzip": gzip.compress,
        "pigz": lambda data: gzip.compress(data[:1_000_000]) + gzip.compress(data[1_000_000:]),
        "zstd": lambda data: (
            subprocess.run(("zstd", "-qc"), input=data, capture_output=True, check=True).stdout
        ),
    }
    packed = packers[pack](OLD)
    robot.old.write_bytes(packed)
    assert robot.run().stdout == NEW
    assert list(robot.scratch.iterdir()) == []
    robot.old.write_bytes(packed[:-100])
    robot.refuses(exit_codes.UNUSABLE)


def test_the_first_file_that_exists_is_taken(robot: Robot) -> None:
    """There are two places where a containerd store may be."""
    assert robot.run(old=rebuild_command.from_files("/nowhere/blob", str(robot.old))).stdout == NEW
    assert robot.run(old=rebuild_command.from_files(str(robot.old), "/nowhere/blob")).stdout == NEW


def test_a_containerd_store_is_found(robot: Robot, tmp_path: Path) -> None:
    """Below the data root, where dockerd runs a containerd of its own."""
    content = tmp_path / "root/containerd/daemon/io.containerd.content.v1.content/blobs/sha256"
    content.mkdir(parents=True)
    (content / ("b" * 64)).write_bytes(gzip.compress(OLD))
    assert (
        robot.run(old=rebuild_command.from_blob("sha256:" + "b" * 64, root=f"{tmp_path}/root")).stdout == NEW
    )


def test_no_such_old_layer(robot: Robot) -> None:
    """It names what it looked for."""
    robot.old.unlink()
    assert str(robot.old) in robot.refuses(exit_codes.MISSING)


def test_a_robot_without_zstd(robot: Robot, tmp_path: Path) -> None:
    """It says so, and does not take the patch for damaged."""
    done = ran("--file", str(robot.old), "--patch", str(robot.patch), diff_id(NEW), path=str(tmp_path))
    assert done.returncode == exit_codes.MISSING
    assert done.stderr == b"zstd: No such file or directory\n"


def test_another_old_layer_of_the_same_size(robot: Robot) -> None:
    """The frame's checksum sees it, before a byte of that segment is believed."""
    robot.old.write_bytes(OLD[:700_000] + b"\0" + OLD[700_001:])
    robot.refuses(exit_codes.UNUSABLE)


def test_an_old_layer_of_another_size(robot: Robot) -> None:
    """Nothing is unpacked at all."""
    robot.old.write_bytes(OLD + bytes(512))
    assert "for an old layer of" in robot.refuses(exit_codes.UNUSABLE)


def test_another_new_layer_was_wanted(robot: Robot) -> None:
    """A patch that works, and makes something else."""
    assert "not sha256:" in robot.refuses(exit_codes.UNUSABLE, wanted=b"other")


@pytest.mark.parametrize("length", [0, 5, 30, len(PATCH) // 2, len(PATCH) - 1])
def test_a_patch_that_was_cut(robot: Robot, length: int) -> None:
    """Wherever it ends."""
    robot.patch.write_bytes(PATCH[:length])
    robot.refuses(exit_codes.UNUSABLE)


def test_a_patch_that_goes_on(robot: Robot) -> None:
    """Then it is not the patch that was made."""
    robot.patch.write_bytes(PATCH + b"!")
    robot.refuses(exit_codes.UNUSABLE)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, len(PATCH) - 1), st.integers(1, 255))
def test_a_damaged_patch(robot: Robot, at: int, flip: int) -> None:
    """One byte anywhere: it makes the right layer all the same, or none and says so."""
    robot.patch.write_bytes(PATCH[:at] + bytes([PATCH[at] ^ flip]) + PATCH[at + 1 :])
    done = robot.run()
    assert (done.returncode, done.stdout == NEW) in ((0, True), (exit_codes.UNUSABLE, False))
    assert done.stderr.count(b"\n") == (0 if done.returncode == 0 else 1)


@pytest.mark.parametrize(
    "header",
    [
        (0, 0, 0, 0),
        (0, 0, patch_format.SEGMENT + 1, 9),
        (0, patch_format.RANGE + 1, 10, 9),
        (patch_format.RANGE * 2, 1, 1, 0),
        (2**63, 1, 1, 0),
    ],
)
def test_a_patch_that_asks_for_what_cannot_be(robot: Robot, header: tuple[int, ...]) -> None:
    """More memory than there may be, bytes that are not there, nothing at all."""
    os.truncate(robot.old, patch_format.RANGE * 2)
    head = f"fleet-patch 1 {patch_format.RANGE * 2} {patch_format.SEGMENT * 2}\n".encode()
    robot.patch.write_bytes(head + patch_format.HEADER.pack(*header) + bytes(99))
    assert "ranges are impossible" in robot.refuses(exit_codes.UNUSABLE)


@pytest.mark.parametrize("length", [9, 11])
def test_a_copy_of_another_length(robot: Robot, length: int) -> None:
    """More or less than was announced is not taken."""
    head = f"fleet-patch 1 {len(OLD)} 10\n".encode()
    robot.patch.write_bytes(head + patch_format.HEADER.pack(0, length, 10, 0))
    assert "a segment has the wrong length" in robot.refuses(exit_codes.UNUSABLE)


def test_a_segment_that_unpacks_to_more_than_it_says_is_stopped(robot: Robot) -> None:
    """A gigabyte of zeros does not arrive where ten bytes were announced."""
    zeros = ("sh", "-c", "head -c 1G /dev/zero | zstd -qc")
    bomb = subprocess.run(zeros, capture_output=True, check=True).stdout
    head = f"fleet-patch 1 {len(OLD)} 10\n".encode()
    robot.patch.write_bytes(head + patch_format.HEADER.pack(0, 100, 10, len(bomb)) + bomb)
    robot.refuses(exit_codes.UNUSABLE)


def test_a_reader_that_goes_away(robot: Robot) -> None:
    """What reads the layer, such as `docker load`, may fail; that is no damage, and no traceback."""
    command = (sys.executable, "-IS", rebuild_layer.__file__, "--file", str(robot.old), diff_id(OLD))
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as program:
        assert program.stdout
        assert program.stderr
        program.stdout.close()
        said = program.stderr.read()
    assert (program.returncode, said) == (exit_codes.BROKEN_OFF, b"reading or writing: Broken pipe\n")


@pytest.mark.parametrize("wanted", ["", "sha256:", "../../etc", "sha256:" + "A" * 64])
def test_what_is_no_digest_is_no_path(wanted: str) -> None:
    """Chain IDs become paths, and the program may run as root."""
    assert ran("--chain", wanted, CHAIN).returncode == 2
    assert ran("--chain", CHAIN, wanted).returncode == 2


@pytest.mark.usefixtures("desktop")  # it takes long
def test_large_layers_are_rebuilt_within_the_promised_memory(robot: Robot) -> None:
    """The program and zstd, each; the range lies in memory too: 150 MB in all."""
    content = noise("large", 70 << 20)
    old, new = (
        tar({"model": content, "a": b"a"}),
        tar({"b": b"b", "model": content[: 40 << 20] + b"!" + content[40 << 20 :]}),
    )
    robot.old.write_bytes(old)
    robot.patch.write_bytes(made(old, new))
    assert robot.patch.stat().st_size < 300_000
    watch = "import resource, subprocess, sys; code = subprocess.call(sys.argv[1:]); print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss); sys.exit(code)"
    command = (
        sys.executable,
        "-IS",
        rebuild_layer.__file__,
        "--file",
        str(robot.old),
        "--patch",
        str(robot.patch),
        "--check",
        diff_id(new),
    )
    done = subprocess.run((sys.executable, "-c", watch, *command), capture_output=True, text=True, check=True)
    assert int(done.stdout) * 1024 < (150 << 20) - patch_format.RANGE - (20 << 20)


def store(root: Path, layer: bytes, *, raw: bool = False) -> None:
    """Lay a tar out as Docker's classic overlay2 store does: files in a directory, the rest in tar-split's JSON."""
    about, diff = root / "image/overlay2/layerdb/sha256" / CHAIN[7:], root / "overlay2/cafe/diff"
    about.mkdir(parents=True)
    diff.mkdir(parents=True)
    (about / "cache-id").write_text("cafe")
    entries, at = [], 0
    with tarfile.open(fileobj=io.BytesIO(layer)) as archive:
        for member in archive:
            entries.append({"type": 2, "payload": base64.b64encode(layer[at : member.offset_data]).decode()})
            name = (
                {"name_raw": base64.b64encode(os.fsencode(member.name)).decode()}
                if raw
                else {"name": member.name}
            )
            entries.append({"type": 1, "size": member.size, "payload": "crc", **name})
            if member.size:
                path = diff / os.path.normpath("/" + member.name).lstrip("/")
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(layer[member.offset_data : member.offset_data + member.size])
            at = member.offset_data + member.size
    entries.append({"type": 2, "payload": base64.b64encode(layer[at:]).decode()})
    lines = (json.dumps({**entry, "position": number}) + "\n" for number, entry in enumerate(entries))
    (about / "tar-split.json.gz").write_bytes(gzip.compress("".join(lines).encode()))


def chain(root: Path) -> tuple[str, ...]:
    return rebuild_command.from_chain(CHAIN, root=str(root))


@pytest.mark.parametrize("raw", [False, True])
def test_a_layer_of_a_classic_store_is_read_where_it_lies(robot: Robot, tmp_path: Path, *, raw: bool) -> None:
    """With names that are no UTF-8, too; whole, and by ranges."""
    odd = tar(
        {"./a": b"a" * 1000, "b\udcff" if raw else "bü": noise("b", 2_000_000), "../c": b"c", "empty": b""}
    )
    store(tmp_path / "root", odd, raw=raw)
    new = odd[:1_000_000] + b"!" + odd[1_000_000:]
    robot.patch.write_bytes(made(odd, new))
    assert robot.run(old=chain(tmp_path / "root"), wanted=odd, patch=False).stdout == odd
    assert robot.run(old=chain(tmp_path / "root"), wanted=new).stdout == new


def test_every_range_of_a_classic_store(tmp_path: Path) -> None:
    """Where it begins and ends makes no difference."""
    layer = tar({"a": b"a" * 700, "empty": b"", "b": b"b" * 512, "c": b"c"})
    store(tmp_path, layer)
    opened = rebuild_layer.from_chain(CHAIN[7:], tmp_path)
    assert opened.size == len(layer)
    for begin in range(0, 6000, 97):
        for count in (0, 1, 511, 512, 513, 4000):
            assert b"".join(opened.read(begin, count)) == layer[begin : begin + count]


@pytest.mark.parametrize("damage", ["gone", "short", "no JSON", "no gzip", "cut"])
def test_a_classic_store_that_is_damaged(robot: Robot, tmp_path: Path, damage: str) -> None:
    """Files that were removed or changed, and broken records: no layer, and one error line."""
    store(tmp_path / "root", OLD)
    books = tmp_path / "root/image/overlay2/layerdb/sha256" / CHAIN[7:] / "tar-split.json.gz"
    file = tmp_path / "root/overlay2/cafe/diff/usr/lib/3"
    match damage:
        case "gone":
            file.unlink()
        case "short":
            file.write_bytes(b"short")
        case "no JSON":
            books.write_bytes(gzip.compress(b"{}\n"))
        case "no gzip":
            books.write_bytes(b"{}\n")
        case _:
            books.write_bytes(books.read_bytes()[:-20])
    done = robot.run(old=chain(tmp_path / "root"))
    assert done.returncode == exit_codes.UNUSABLE
    assert len(done.stdout) < len(NEW)
    assert done.stderr.count(b"\n") == 1


def test_a_classic_store_without_that_layer(robot: Robot, tmp_path: Path) -> None:
    """Another exit code than damage: another strategy may help."""
    assert robot.run(old=chain(tmp_path)).returncode == exit_codes.MISSING


PIECES = st.lists(
    st.tuples(st.integers(0, len(OLD)), st.integers(0, 400_000), st.binary(max_size=50)), max_size=4
)


@settings(max_examples=10, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(PIECES)
def test_any_edits_go_all_the_way(robot: Robot, edits: list[tuple[int, int, bytes]]) -> None:
    """What the desktop packs is what the robot makes."""
    new = OLD
    for at, cut, more in edits:
        new = new[:at] + more + new[at + cut :]
    robot.patch.write_bytes(made(OLD, new))
    done = robot.run(wanted=new)
    assert (done.returncode, done.stderr, done.stdout == new) == (0, b"", True)


def test_this_file_has_patches_worth_testing() -> None:
    """The patch above refers to the old layer, and is much smaller than the new one."""
    assert any(segment.packed and segment.length for segment in segments(PATCH))
    assert len(PATCH) < len(NEW) / 20


def test_old_pythons_can_read_it() -> None:
    """Robots have Python 3.8, and maybe no more of its library than Debian's python3-minimal brings."""
    tree = ast.parse(rebuild_command.program(), feature_version=(3, 8))
    names = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    names |= {str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    minimal = {
        "argparse",
        "array",
        "base64",
        "bisect",
        "contextlib",
        "hashlib",
        "json",
        "os",
        "pathlib",
        "re",
        "struct",
    }
    assert names - {"__future__", "collections.abc", "typing"} <= minimal | {
        "subprocess",
        "sys",
        "threading",
        "zlib",
    }
