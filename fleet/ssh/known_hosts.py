"""Which host keys do we trust? The ``known_hosts`` format of OpenSSH (sshd(8), "SSH_KNOWN_HOSTS FILE FORMAT").

Paramiko's own loader raises on ``@cert-authority`` and ``@revoked`` lines and can rewrite the user's file; this reader
supports markers, hashed names, wildcards and negation, and writes only the project's own file.
"""

from __future__ import annotations

import base64
import binascii
import contextlib
import fcntl
import hashlib
import hmac
import os
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from fleet.errors import DesktopError, InventoryError, UntrustedHostKey

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

Verdict = Literal["known", "unknown", "changed", "revoked"]

_RSA = ("rsa-sha2-512", "rsa-sha2-256")
_PLAIN = re.compile(r"[^|*?!,]*").fullmatch


@dataclass(frozen=True, kw_only=True)
class HostKey:
    """A public host key: its type (``ssh-ed25519``) and its bytes in wire format."""

    kind: str
    blob: bytes

    @property
    def fingerprint(self) -> str:
        """As ``ssh-keygen -l`` prints it: ``SHA256:`` and the unpadded base64 of the digest."""
        return "SHA256:" + base64.b64encode(hashlib.sha256(self.blob).digest()).decode().rstrip("=")


@dataclass(frozen=True, kw_only=True)
class Entry:
    """The content of one line: a key, trusted or revoked, and ``where`` it stands (``file:line``)."""

    key: HostKey
    revoked: bool
    where: str


@dataclass(frozen=True, kw_only=True)
class KnownHosts:
    """The lines of several ``known_hosts`` files, the project's first, each with its place.

    Lines are parsed only when a name is looked up: a file may have thousands, and each robot needs one.
    """

    lines: tuple[tuple[str, str], ...] = ()

    def entries(self, name: str) -> tuple[Entry, ...]:
        """Return the entries for ``name`` (``host``, or ``[host]:port``)."""
        lowered = name.lower()
        entries = (_entry(text, name=lowered, where=where) for where, text in self.lines)
        return tuple(entry for entry in entries if entry)

    def verdict(self, name: str, key: HostKey) -> Verdict:
        """Return whether these files trust ``key`` for ``name``."""
        entries = self.entries(name)
        if any(entry.revoked and entry.key.blob == key.blob for entry in entries):
            return "revoked"
        trusted = [entry.key.blob for entry in entries if not entry.revoked]
        if key.blob in trusted:
            return "known"
        return "changed" if trusted else "unknown"

    def algorithms(self, name: str) -> tuple[str, ...]:
        """Return the key types to ask a host for first: a key of a type that is not recorded looks like another host.

        Files name RSA keys by their type, the protocol names them by their signature (RFC 8332).
        """
        kinds = dict.fromkeys(entry.key.kind for entry in self.entries(name) if not entry.revoked)
        return tuple(name for kind in kinds for name in (_RSA if kind == "ssh-rsa" else (kind,)))


def read(paths: Iterable[Path]) -> KnownHosts:
    """Read files; missing ones are left out.

    Raises:
        InventoryError: a file exists but cannot be read.

    """
    lines: list[tuple[str, str]] = []
    for path in paths:
        try:
            text = path.read_text(encoding="utf-8", errors="replace")
        except (FileNotFoundError, NotADirectoryError):
            continue
        except OSError as problem:
            cure = "make the file readable"
            raise InventoryError(f"cannot read {path}: {problem.strerror}", cure=cure) from problem
        lines += ((f"{path}:{number}", line) for number, line in enumerate(text.split("\n"), start=1))
    return KnownHosts(lines=tuple(lines))


def record(path: Path, *, name: str, key: HostKey) -> None:
    """Write one key into the project's file; it replaces the file's other keys for this name.

    Raises:
        DesktopError: the file cannot be written.

    """
    line = f"{name} {key.kind} {base64.b64encode(key.blob).decode()}\n"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with _alone(path.parent):
            old = path.read_text(encoding="utf-8").splitlines(keepends=True) if path.exists() else []
            kept = [text.rstrip("\r\n") + "\n" for text in old if text.split(maxsplit=1)[:1] != [name]]
            new = path.with_name(path.name + ".new")
            new.write_text("".join((*kept, line)), encoding="utf-8")
            new.replace(path)
    except OSError as problem:
        cure = "make the file writable; the host key was not recorded"
        raise DesktopError(f"cannot write {path}: {problem.strerror}", cure=cure) from problem


def host_name(host: str, port: int) -> str:
    """Return a host's name in ``known_hosts`` files: ``host``, or ``[host]:port`` if the port is not 22."""
    return host if port == 22 else f"[{host}]:{port}"


def check(key: HostKey, *, name: str, known: KnownHosts, jump: bool = False) -> None:
    """Accept a known key. ``jump``: the key belongs to a jump host, not to a robot.

    Raises:
        UntrustedHostKey: the key is unknown, has changed, or is revoked.

    """
    match known.verdict(name, key):
        case "known":
            return
        case "unknown":
            what = f"the host key of {name} is not known yet: it offers {key.kind} {key.fingerprint}"
            cure = (
                "connect to that jump host once with `ssh`"
                if jump
                else "`fab trust` shows the key and records it"
            )
        case "changed":
            on_record = ", ".join(entry.where for entry in known.entries(name) if not entry.revoked)
            what = f"the host key of {name} CHANGED: it offers {key.kind} {key.fingerprint}, not what {on_record} says"
            again = f"`ssh-keygen -R '{name}'` and `ssh` to it once" if jump else "`fab trust --changed`"
            cure = f"if it was reinstalled, {again}; if not, another machine may be answering"
        case "revoked":
            what = f"the host key of {name} is revoked: {key.fingerprint}"
            cure = "remove the old host key on it, and make a new one with `ssh-keygen -A`"
    raise UntrustedHostKey(what, cure=cure)


@contextlib.contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Allow one writer at a time: two ``fab trust`` would overwrite each other's keys."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def _entry(line: str, *, name: str, where: str) -> Entry | None:
    """Read one line. Returns nothing for another host, or for a line that is not valid: OpenSSH ignores those too."""
    if line.lstrip().startswith("#"):  # a comment; after a marker, `#` is a letter of a name
        return None
    fields = line.split(maxsplit=4)
    marker = fields.pop(0) if fields and fields[0].startswith("@") else ""
    # Certificate authorities are ignored: Paramiko cannot check host certificates.
    if len(fields) < 3 or marker not in ("", "@revoked"):
        return None
    if not _names_match(fields[0], name):
        return None
    try:
        blob = base64.b64decode(fields[2], validate=True)
    except (binascii.Error, ValueError):
        return None
    return Entry(key=HostKey(kind=fields[1], blob=blob), revoked=bool(marker), where=where)


def _names_match(names: str, name: str) -> bool:
    """Whether the first field of a line matches ``name``: a hash, or patterns, where a negated pattern wins."""
    if _PLAIN(names):
        return names.lower() == name
    if names.startswith("|"):
        return _hash_matches(names, name)
    patterns = names.lower().split(",")
    if any(_glob_matches(pattern[1:], name) for pattern in patterns if pattern.startswith("!")):
        return False
    return any(_glob_matches(pattern, name) for pattern in patterns)


def _glob_matches(pattern: str, name: str) -> bool:
    """Match a pattern with ``*`` and ``?``; brackets are literal, as in ``[host]:port``."""
    if "*" not in pattern and "?" not in pattern:
        return pattern == name
    regex = re.escape(pattern).replace(r"\*", ".*").replace(r"\?", ".")
    return re.fullmatch(regex, name) is not None


def _hash_matches(hashed: str, name: str) -> bool:
    """Compare with a hash that ``ssh-keygen -H`` wrote: ``|1|salt|hash``, HMAC-SHA1 of the name."""
    try:
        salt, digest = (
            base64.b64decode(part, validate=True) for part in hashed.removeprefix("|1|").split("|")
        )
    except (binascii.Error, ValueError):
        return False
    return hmac.compare_digest(hmac.digest(salt, name.encode(), "sha1"), digest)
