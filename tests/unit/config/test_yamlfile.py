from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.config import yamlfile
from fleet.errors import ComposeError, InventoryError

if TYPE_CHECKING:
    from fleet.config.yamlfile import Location, Value


def document(source: str, path: Path) -> yamlfile.Document:
    path.write_text(source, encoding="utf-8")
    return yamlfile.read(path, error=ComposeError)


def refusal(source: str | bytes, path: Path) -> str:
    path.write_bytes(source if isinstance(source, bytes) else source.encode())
    with pytest.raises(ComposeError) as raised:
        yamlfile.read(path, error=ComposeError)
    return str(raised.value).replace(str(path), "FILE")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "some.yaml"


@pytest.mark.parametrize(
    ("source", "value"),
    [
        ("a: 1", {"a": 1}),
        ("a: [x, 1.5, true, ~]\nb: {c: d}", {"a": ["x", 1.5, True, None], "b": {"c": "d"}}),
        ("on: 1\n2: x\nnull: y", {"on": 1, "2": "x", "null": "y"}),
        ("day: 2024-01-01", {"day": "2024-01-01"}),
        ("\ufeffa: 1", {"a": 1}),
        ("a: |\n  x\n  y\n", {"a": "x\ny\n"}),
        ("a: &x {k: 1, l: 2}\nb: {<<: *x, k: 3}", {"a": {"k": 1, "l": 2}, "b": {"k": 3, "l": 2}}),
        (
            "a: &x {k: 1}\nb: &y {k: 2, l: 2}\nc: {<<: [*x, *y]}",
            {"a": {"k": 1}, "b": {"k": 2, "l": 2}, "c": {"k": 1, "l": 2}},
        ),
        ("a: !!int word", {"a": "word"}),
        (f"a: {'9' * 5000}", {"a": "9" * 5000}),
    ],
)
def test_value(path: Path, source: str, value: Value) -> None:
    """A file reads as plain data, with keys and dates as text."""
    assert document(source, path).value == value


def test_aliases_share_one_value(path: Path) -> None:
    """A file whose aliases would expand to a thousand million values reads at once."""
    layers = "".join(f"a{n + 1}: &a{n + 1} [{', '.join([f'*a{n}'] * 10)}]\n" for n in range(9))
    assert len(document(f"a0: &a0 [x]\n{layers}", path).value) == 10


@pytest.mark.parametrize(
    ("location", "line"),
    [
        ((), 1),
        (("robots",), 2),
        (("robots", "pi1"), 3),
        (("robots", "pi1", "port"), 4),
        (("robots", "pi1", "no such"), 3),
        (("robots", "pi2", "port"), 6),
        (("list", 0), 8),
        (("list", 1), 9),
        (("list", 1, "x"), 10),
        (("list", 7), 7),
        (("flow", 1), 12),
    ],
)
def test_line(path: Path, location: Location, line: int) -> None:
    """A location answers with the line of its key or item, or of the nearest thing that is there."""
    source = """# prose
robots:
  pi1: &one
    port: 22
    user: pi
  pi2: {<<: *one, port: 23}
list:
  - a
  - b: 1
    x: 2
flow: [1,
  2]
"""
    assert document(source, path).line(location) == line


def test_text(path: Path) -> None:
    """Scalars answer with what was written; what is no scalar, or is not there, has no text."""
    read = document("a: 1.50\nb: [042, {}]\nc: 'x'", path)
    locations: list[Location] = [("a",), ("b", 0), ("b",), ("c",), ("d",)]
    assert [read.text(location) for location in locations] == ["1.50", "042", None, "x", None]
    assert read.texts(("b",)) == ("042", None)
    assert read.texts(("a",)) == read.texts(("d",)) == ()


def test_without(path: Path) -> None:
    """What is left without some locations keeps everything else, and holders go where the rest of a way is missing."""
    read = document("a: [1, 2, 3, {b: 4, c: 5}]\nd: {e: f, g: h}\ni: j", path)
    without = read.without(
        [("a", 0), ("a", 2), ("a", 3, "b"), ("d", "e"), ("i", "address"), ("nothing", "there")]
    )
    assert without == {"a": [2, {"c": 5}], "d": {"g": "h"}}


@pytest.mark.parametrize(
    ("source", "sentence"),
    [
        ("", "FILE is empty"),
        ("# only prose\n", "FILE is empty"),
        ("- a\n", "FILE:1: holds a list; a mapping is needed here: lines like `key: value`"),
        ("word", "FILE:1: holds a single value; a mapping is needed here: lines like `key: value`"),
        ("a:\n\tb: 1", "FILE:2: a tab in the indentation; YAML wants spaces"),
        ("a:\n  b: 1\n\tc: 2", "FILE:3: a tab in the indentation; YAML wants spaces"),
        (
            "a: b: c",
            "FILE:1: not YAML: a second `:` here, or the indentation is wrong; quote text that holds `: `",
        ),
        ("a: 1\nb 2\nc: 3", "FILE:2: not YAML: this line has no `:`; write `key: value`"),
        ("a: 1\n---\nb: 2", "FILE:2: not YAML: a second document (`---`) starts here; keep one per file"),
        ("x: 1\na: 'b\n\nc: 1", "FILE:2: not YAML: the quote that opens here is never closed"),
        (
            "a: [1, 2\n",
            "FILE:1: not YAML: the bracket that opens here is never closed, or a comma is missing in it",
        ),
        ("a:\n    b: 1\n  c: 2", "FILE:3: not YAML: this line is not indented like the ones it belongs to"),
        ("a: @b", "FILE:1: not YAML: text cannot begin with this character; put it in quotes"),
        (
            "a: *b",
            "FILE:1: not YAML: an alias (`*`) without its anchor (`&`); put text that begins with `*` in quotes",
        ),
        ("a: 1\nb: \x01", "FILE:2: a character that YAML does not allow (U+0001)"),
        (b"a: \xff", "FILE is not UTF-8 text (byte 3); save it as UTF-8"),
        ("a: 1\nb: 2\na: 3", "FILE:3: the key 'a' is already on line 1; remove one of them"),
        (
            "a: {b: 1, b: 2}\na: 3",
            "FILE:1: the key 'b' is already on line 1; remove one of them\nFILE:2: the key 'a' is already on line 1; remove one of them",
        ),
        ("? [a]\n: 1", "FILE:1: a key must be plain text"),
        ("a: &x [*x]", "FILE:1: an alias (`*`) of something that contains it"),
        ("a: {<<: 1}", "FILE:1: `<<` merges mappings only"),
        (
            "a: !secret b",
            "FILE:1: a tag (`!`) that means nothing here; put text that begins with `!` in quotes",
        ),
        (
            "a: !secret [b]",
            "FILE:1: a tag (`!`) that means nothing here; put text that begins with `!` in quotes",
        ),
        ('a: "\\0"', "FILE:1: a character that no text can hold (NUL, or half of a surrogate pair)"),
        ('"\\ud800": a', "FILE:1: a character that no text can hold (NUL, or half of a surrogate pair)"),
        ("a: " + "[" * 9999, "FILE is nested too deeply"),
    ],
)
def test_refusal(path: Path, source: str | bytes, sentence: str) -> None:
    """What is no usable YAML is refused in one sentence with its line."""
    assert refusal(source, path) == sentence


def test_no_file(path: Path) -> None:
    """A missing file is refused with the caller's cure."""
    with pytest.raises(InventoryError) as raised:
        yamlfile.read(path, error=InventoryError, cure="make one")
    assert str(raised.value) == f"{path}: no such file; make one"


def test_folder(tmp_path: Path) -> None:
    """A directory is refused as one."""
    with pytest.raises(ComposeError, match="is a directory; name a YAML file"):
        yamlfile.read(tmp_path, error=ComposeError)


def test_what_has_no_end(tmp_path: Path) -> None:
    """A device, and a pipe that nobody writes to."""
    with pytest.raises(ComposeError, match=r"/dev/zero has more than 1\.0 MB; name a YAML file"):
        yamlfile.read(Path("/dev/zero"), error=ComposeError)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ComposeError, match="pipe is a pipe; name a YAML file"):
        yamlfile.text(tmp_path / "pipe", error=ComposeError, once=True)


@pytest.mark.parametrize("place", ["/dev/fd/{}", "/proc/self/fd/{}", "/proc/PID/fd/{}", "/dev/stdin"])
def test_a_pipe_of_the_shell(place: str) -> None:
    """Is read where once is enough, and the paths in it begin where the person is; Compose would read it a second time."""
    reader, writer = os.pipe()
    os.write(writer, b"a: 1")
    os.close(writer)
    stdin = os.dup(0)
    os.dup2(reader, 0)
    try:
        path = Path(place.format(reader).replace("PID", str(os.getpid())))
        with pytest.raises(ComposeError, match="is a pipe; name a YAML file"):
            yamlfile.text(path, error=ComposeError)
        assert yamlfile.text(path, error=ComposeError, once=True) == "a: 1"
        assert yamlfile.folder(path) == Path.cwd()
    finally:
        os.dup2(stdin, 0)
        os.close(stdin)
        os.close(reader)


def test_unreadable(path: Path) -> None:
    """A file that cannot be opened is refused with the system's reason."""
    path.symlink_to(path)
    with pytest.raises(ComposeError, match=r"cannot be read: Too many levels of symbolic links"):
        yamlfile.read(path, error=ComposeError)


def test_impossible_name() -> None:
    """A name that no file can have is refused like any other."""
    with pytest.raises(ComposeError, match="cannot be read: embedded null byte"):
        yamlfile.read(Path("a/\0"), error=ComposeError)


yamlish = st.text(st.sampled_from("ab:- \n[]{},&*!<'\"|>?#%@\t01~."), max_size=60)


@given(st.one_of(st.text(), yamlish))
def test_anything(source: str) -> None:
    """Any text is a document or a refusal, and each of a document's values has a line within the text."""
    try:
        read, problems = yamlfile.parse(source, path=Path("any.yaml"), error=ComposeError)
    except ComposeError:
        return
    lines = (
        source.count("\n")
        + 1
        + source.count("\r")
        + source.count("\x85")
        + source.count("\u2028")
        + source.count("\u2029")
    )
    assert all(1 <= read.line((key,)) <= lines for key in read.value)
    assert all(1 <= line <= lines for line, _ in problems)
