"""What does this YAML file say, and on which line?

Any YAML file: the inventory and the stack's Compose file both come through here. A `Document` is plain data (mappings,
lists, text, numbers, true/false, nothing) that still knows its lines, so whoever checks it can say ``file:line``.

Two of YAML's traps are closed: keys are text as written (a robot called ``on`` stays one), and so are dates.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from pathlib import Path
from typing import TYPE_CHECKING

import yaml

from fleet.units import human_bytes

if TYPE_CHECKING:
    from fleet.errors import UsageError

LARGEST = 1_000_000
"""Bytes of a file. Two hundred robots have 0.1 MB; a device such as /dev/zero has no end."""

_OF_THE_SHELL = re.compile(r"/dev/stdin|/dev/fd/\d+|/proc/(self|thread-self|\d+)/fd/\d+").fullmatch
"""What a shell puts in the place of ``<(...)``, and what people write for its pipes."""

Value = str | int | float | bool | list["Value"] | dict[str, "Value"] | None
Location = Sequence[str | int]
Problem = tuple[int, str]


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One value with its place: ``line`` is the one of its key (or list item), ``text`` a scalar as it was written."""

    line: int
    value: Value
    text: str | None = None
    inside: Mapping[str | int, Entry] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Document:
    """A YAML file with a mapping at its top; ``source`` is its text."""

    path: Path
    root: Entry
    source: str = ""

    @property
    def value(self) -> dict[str, Value]:
        """All of it as plain data."""
        return self.root.value if isinstance(self.root.value, dict) else {}

    def line(self, location: Location) -> int:
        """The line, from 1, of ``location``: keys and list positions from the top. The nearest that exists."""
        return self._entry(location)[0].line

    def written(self, location: Location) -> Location:
        """A location without the steps that a short form leaves out: ``stack[0].files[0]`` is ``stack`` in ``stack: x``."""
        steps: list[str | int] = []
        for step in location:
            entry, _ = self._entry(steps)
            if not entry.inside:
                break
            if step in entry.inside or isinstance(step, str):
                steps.append(step)
        return tuple(steps)

    def texts(self, location: Location) -> tuple[str | None, ...]:
        """The items of the list at ``location`` as written; empty where there is no list."""
        entry, found = self._entry(location)
        return (
            tuple(item.text for item in entry.inside.values())
            if found and isinstance(entry.value, list)
            else ()
        )

    def text(self, location: Location) -> str | None:
        """The scalar at ``location`` exactly as written (``1.50``, ``042``); None where there is none."""
        entry, found = self._entry(location)
        return entry.text if found else None

    def without(self, locations: Sequence[Location]) -> Value:
        """The plain data without what is at ``locations``, or the nearest thing around it."""
        # From the end, or positions in a list would shift.
        return reduce(_without, reversed(locations), self.root.value)

    def _entry(self, location: Location) -> tuple[Entry, bool]:
        entry = self.root
        for key in location:
            if key not in entry.inside:
                return entry, False
            entry = entry.inside[key]
        return entry, True


def _without(value: Value, location: Location) -> Value:
    step, *rest = location
    if isinstance(value, dict) and step in value:
        return {
            key: _without(inner, rest) if key == step else inner
            for key, inner in value.items()
            if key != step or (rest and isinstance(inner, list | dict))
        }
    if isinstance(value, list):
        return [
            _without(inner, rest) if position == step else inner
            for position, inner in enumerate(value)
            if position != step or (rest and isinstance(inner, list | dict))
        ]
    return value


def read(path: Path, *, error: type[UsageError], cure: str = "") -> Document:
    """The document in the file at ``path``.

    Raises ``error`` with one sentence per problem when there is no such file (with your ``cure``), it cannot be read,
    is not YAML, names a key twice, or holds no mapping.
    """
    document, problems = parse(text(path, error=error, cure=cure), path=path, error=error)
    if problems:
        raise error("\n".join(f"{path}:{line}: {what}" for line, what in problems))
    return document


def folder(path: Path) -> Path:
    """The folder from which the paths in a file count: its own, or for a pipe of the shell that in which the person is."""
    return Path.cwd() if _OF_THE_SHELL(str(path)) else path.parent


def text(path: Path, *, error: type[UsageError], cure: str = "", once: bool = False) -> str:
    """The text of the file at ``path``; raises ``error`` as `read` does, and for a file that is larger than `LARGEST`.

    A pipe is refused: nobody may write to it, and it can be read only once. If ``once`` is enough, those of a shell are read.
    """
    try:
        if path.is_fifo() and not (once and _OF_THE_SHELL(str(path))):
            raise error(f"{path} is a pipe", cure="name a YAML file")
        with path.open("rb") as file:
            data = file.read(LARGEST + 1)
        if len(data) > LARGEST:
            raise error(
                f"{path} has more than {human_bytes(LARGEST)}",
                cure="name a YAML file",
            )
        return data.decode("utf-8-sig")
    except FileNotFoundError:
        raise error(f"{path}: no such file", cure=cure) from None
    except IsADirectoryError:
        raise error(f"{path} is a directory", cure="name a YAML file") from None
    except UnicodeDecodeError as bad:
        raise error(f"{path} is not UTF-8 text (byte {bad.start})", cure="save it as UTF-8") from None
    except (OSError, ValueError) as bad:
        reason = bad.strerror if isinstance(bad, OSError) else str(bad)
        raise error(f"{path} cannot be read: {reason}") from None


def parse(source: str, *, path: Path, error: type[UsageError]) -> tuple[Document, tuple[Problem, ...]]:
    """The document in ``source``, and the problems it can be read in spite of, such as a key that is there twice.

    A problem is a line and a sentence. ``path`` is for messages. Raises ``error`` where nothing can be read: a syntax error, an empty file, no mapping.
    """
    try:
        node = yaml.compose(source, Loader=yaml.SafeLoader)
        builder = _Builder()
        root = builder.entry(node, line=1) if node else None
    except yaml.reader.ReaderError as bad:
        line = source.count("\n", 0, bad.position) + 1
        raise error(f"{path}:{line}: a character that YAML does not allow (U+{bad.character:04X})") from None
    except yaml.MarkedYAMLError as bad:
        raise _syntax_error(bad, source=source, path=path, error=error) from None
    except RecursionError:
        raise error(f"{path} is nested too deeply") from None
    if root is None or root.value is None:
        raise error(f"{path} is empty")
    if not isinstance(root.value, dict):
        kind = "a list" if isinstance(root.value, list) else "a single value"
        raise error(f"{path}:1: holds {kind}", cure="a mapping is needed here: lines like `key: value`")
    return Document(path=path, root=root, source=source), tuple(builder.problems)


# What PyYAML says, what it means, the cure.
_MEANINGS = (
    ("while scanning a quoted scalar", "the quote that opens here is never closed", ""),
    ("while parsing a flow", "the bracket that opens here is never closed, or a comma is missing in it", ""),
    ("while scanning a simple key", "this line has no `:`", "write `key: value`"),
    (
        "mapping values are not allowed",
        "a second `:` here, or the indentation is wrong",
        "quote text that holds `: `",
    ),
    ("expected a single document", "a second document (`---`) starts here", "keep one per file"),
    ("while parsing a block", "this line is not indented like the ones it belongs to", ""),
    ("cannot start any token", "text cannot begin with this character", "put it in quotes"),
    (
        "found undefined alias",
        "an alias (`*`) without its anchor (`&`)",
        "put text that begins with `*` in quotes",
    ),
    (
        "found duplicate anchor",
        "an anchor (`&`) that is there twice",
        "put text that begins with `&` in quotes",
    ),
)
_OPENED = ("while scanning a quoted scalar", "while parsing a flow", "while scanning a simple key")


def _syntax_error(
    bad: yaml.MarkedYAMLError, *, source: str, path: Path, error: type[UsageError]
) -> UsageError:
    said = f"{bad.context or ''} {bad.problem or ''}".strip()
    end = bad.problem_mark or bad.context_mark
    mark = bad.context_mark if said.startswith(_OPENED) else end
    if end and _tab_indents(source[: end.index + 1]):
        return error(f"{path}:{end.line + 1}: a tab in the indentation", cure="YAML wants spaces")
    # PyYAML quotes what it has found there, and that may be a part of a passphrase.
    unquoted = re.sub(r""" ?(['"]).{2,}\1""", "", said)
    what, cure = next(((what, cure) for key, what, cure in _MEANINGS if key in said), (unquoted, ""))
    return error(f"{path}:{mark.line + 1 if mark else 1}: not YAML: {what}", cure=cure)


def _tab_indents(text: str) -> bool:
    # Up to here there is nothing but white space on the line, and a tab in it.
    line = text[text.rfind("\n") + 1 :]
    return "\t" in line and not line.strip()


_TAGS = "tag:yaml.org,2002:"
_KINDS = frozenset({"map", "seq", "str", "int", "float", "bool", "null", "timestamp", "value", "merge"})


class _Builder:
    """Turns PyYAML's nodes into entries; ``problems`` collects what is wrong but leaves the rest readable."""

    def __init__(self) -> None:
        self.problems: list[Problem] = []
        self._scalars = yaml.constructor.SafeConstructor()
        self._open: set[int] = set()
        self._made: dict[int, Entry] = {}

    def entry(self, node: yaml.Node, *, line: int) -> Entry:
        """The entry of ``node``, whose key is on ``line``. Aliases share one value, however often they are used."""
        made = self._made.get(id(node))
        if made is None:
            if id(node) in self._open:
                self._problem(node, "an alias (`*`) of something that contains it")
                return Entry(line=line, value=None)
            self._open.add(id(node))
            made = self._made[id(node)] = self._make(node)
            self._open.discard(id(node))
        return Entry(line=line, value=made.value, text=made.text, inside=made.inside)

    def _make(self, node: yaml.Node) -> Entry:
        if node.tag.removeprefix(_TAGS) not in _KINDS:
            # Without the tag's own text: it may be a passphrase that begins with `!`.
            self._problem(
                node, "a tag (`!`) that means nothing here; put text that begins with `!` in quotes"
            )
        if isinstance(node, yaml.MappingNode):
            keyed: dict[str | int, Entry] = dict(self._pairs(node))
            mapping = {str(key): entry.value for key, entry in keyed.items()}
            return Entry(line=_line(node), value=mapping, inside=keyed)
        if isinstance(node, yaml.SequenceNode):
            items = [self.entry(item, line=_line(item)) for item in node.value]
            return Entry(
                line=_line(node), value=[item.value for item in items], inside=dict(enumerate(items))
            )
        return Entry(line=_line(node), value=self._scalar(node), text=node.value)

    def _pairs(self, node: yaml.MappingNode) -> Iterator[tuple[str, Entry]]:
        """Key and entry, what ``<<`` merges in first: later pairs win."""
        seen: dict[str, int] = {}
        own: list[tuple[str, Entry]] = []
        for key, value in node.value:
            if key.tag == f"{_TAGS}merge":
                yield from self._merged(value)
            elif not isinstance(key, yaml.ScalarNode):
                self._problem(key, "a key must be plain text")
            elif not self._usable(key):
                continue
            elif key.value in seen:
                self._problem(
                    key, f"the key '{key.value}' is already on line {seen[key.value]}; remove one of them"
                )
            else:
                seen[key.value] = _line(key)
                own.append((key.value, self.entry(value, line=_line(key))))
        yield from own

    def _merged(self, node: yaml.Node) -> Iterator[tuple[str, Entry]]:
        sources = node.value if isinstance(node, yaml.SequenceNode) else [node]
        for source in reversed(sources):
            if not isinstance(source, yaml.MappingNode):
                self._problem(source, "`<<` merges mappings only")
                continue
            for key, entry in self.entry(source, line=_line(source)).inside.items():
                yield str(key), entry

    def _scalar(self, node: yaml.Node) -> str | int | float | bool | None:
        if not self._usable(node):
            return None
        if node.tag.removeprefix(_TAGS) in {"int", "float", "bool", "null"}:
            try:
                value: object = self._scalars.construct_object(node)
            except (ValueError, LookupError, ArithmeticError):
                return str(node.value)
            return value if isinstance(value, int | float) else None
        return str(node.value)

    def _usable(self, node: yaml.Node) -> bool:
        """False, and a problem, for text that neither a file name nor an environment can hold."""
        if "\0" not in node.value and not any("\ud800" <= letter <= "\udfff" for letter in node.value):
            return True
        self._problem(node, "a character that no text can hold (NUL, or half of a surrogate pair)")
        return False

    def _problem(self, node: yaml.Node, what: str) -> None:
        self.problems.append((_line(node), what))


def _line(node: yaml.Node) -> int:
    return int(node.start_mark.line) + 1


def dump(value: object) -> str:
    """Return YAML for other programs: mappings in their order, text with several lines as a block."""
    return yaml.dump(value, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=1000)


class _Dumper(yaml.SafeDumper):
    """PyYAML's own, which also writes lines as lines, and no aliases."""

    def ignore_aliases(self, data: object) -> bool:  # noqa: ARG002  see PyYAML
        return True


def _lines(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    return dumper.represent_scalar(f"{_TAGS}str", text, style="|" if "\n" in text else None)


_Dumper.add_representer(str, _lines)
