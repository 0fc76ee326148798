"""Which host keys do we trust? The ``known_hosts`` format of OpenSSH (sshd(8), "SSH_KNOWN_HOSTS FILE FORMAT").

Paramiko's own loader raises on ``@cert-authority`` and ``@revoked`` lines and can rewrite the user's file; this reader
knows the markers, hashed names, wildcards and negation, and only ever writes the project's own file.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import hmac
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from fleet.errors import InventoryError, UntrustedHostKey

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

Verdict = Literal["known", "unknown", "changed", "revoked"]


@dataclass(frozen=True, kw_only=True)
class HostKey:
    """A public host key: its type (``ssh-ed25519``) and its bytes as they go over the wire."""

    kind: str
    blob: bytes

    @property
    def fingerprint(self) -> str:
        """As ``ssh-keygen -l`` prints it: ``SHA256:`` and the unpadded base64 of the digest."""
        return "SHA256:" + base64.b64encode(hashlib.sha256(self.blob).digest()).decode().rstrip("=")


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One line of a ``known_hosts`` file."""

    patterns: tuple[str, ...]
    key: HostKey
    revoked: bool = False

    def matches(self, name: str) -> bool:
        """Whether this line speaks of ``name`` (a host, or ``[host]:port``): negated patterns win."""
        if len(self.patterns) == 1 and self.patterns[0].startswith("|1|"):
            return _hash_matches(self.patterns[0], name)
        negated = any(_glob_matches(p[1:], name) for p in self.patterns if p.startswith("!"))
        return not negated and any(_glob_matches(p, name) for p in self.patterns if not p.startswith("!"))


@dataclass(frozen=True, kw_only=True)
class KnownHosts:
    """The entries of several ``known_hosts`` files, the project's first."""

    entries: tuple[Entry, ...] = ()

    def verdict(self, name: str, key: HostKey) -> Verdict:
        """What these files say of ``key`` offered by ``name`` (``host`` or ``[host]:port``)."""
        matching = [entry for entry in self.entries if entry.matches(name)]
        if any(entry.revoked and entry.key.blob == key.blob for entry in matching):
            return "revoked"
        trusted = [entry.key for entry in matching if not entry.revoked]
        if any(known.blob == key.blob for known in trusted):
            return "known"
        return "changed" if trusted else "unknown"

    def kinds(self, name: str) -> tuple[str, ...]:
        """The key types known for ``name``: to be asked for first, or a host with several looks changed."""
        kinds = (entry.key.kind for entry in self.entries if entry.matches(name) and not entry.revoked)
        return tuple(dict.fromkeys(kinds))


def read(paths: Iterable[Path]) -> KnownHosts:
    """Read files, those that do not exist left out.

    Raises:
        InventoryError: a file is there and cannot be read.

    """
    entries: list[Entry] = []
    for path in paths:
        try:
            text = path.read_text(encoding="utf-8", errors="replace")
        except (FileNotFoundError, NotADirectoryError):
            continue
        except OSError as problem:
            raise InventoryError(f"cannot read {path}: {problem.strerror}") from problem
        entries += parse(text)
    return KnownHosts(entries=tuple(entries))


def parse(text: str) -> list[Entry]:
    """Parse the text of a ``known_hosts`` file; lines that are not entries are passed over, as OpenSSH does."""
    return [entry for line in text.splitlines() if (entry := _entry(line.split()))]


def record(path: Path, *, name: str, key: HostKey) -> None:
    """Write one key into the project's file, in place of the keys it has for that very name."""
    old = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    kept = [line for line in old if line.split(maxsplit=1)[:1] != [name]]
    path.parent.mkdir(parents=True, exist_ok=True)
    new = path.with_name(path.name + ".new")
    new.write_text(
        "\n".join([*kept, f"{name} {key.kind} {base64.b64encode(key.blob).decode()}", ""]), encoding="utf-8"
    )
    new.replace(path)


def host_name(host: str, port: int) -> str:
    """The name under which ``known_hosts`` files keep a host: ``host``, or ``[host]:port`` off port 22."""
    return host if port == 22 else f"[{host}]:{port}"


def check(key: HostKey, *, name: str, known: KnownHosts) -> None:
    """Let a known key pass.

    Raises:
        UntrustedHostKey: the key is unknown, not the known one, or revoked.

    """
    match known.verdict(name, key):
        case "known":
            return
        case "unknown":
            what = f"the host key of {name} is not known yet"
            cure = f"`fab trust` shows it ({key.fingerprint}) and records it"
        case "changed":
            what = f"the host key of {name} CHANGED: it offers {key.kind} {key.fingerprint}, another one is on record"
            cure = "if the robot was set up again, `fab trust --changed`; if not, this may be another machine"
        case "revoked":
            what = f"the host key of {name} is revoked: {key.fingerprint}"
            cure = "give the robot a new host key"
    raise UntrustedHostKey(what, cure=cure)


def _entry(fields: list[str]) -> Entry | None:
    if not fields or fields[0].startswith("#"):
        return None
    marker = fields.pop(0) if fields[0].startswith("@") else ""
    if marker not in ("", "@revoked") or len(fields) < 3:
        return None  # certificate authorities: Paramiko cannot check host certificates
    try:
        blob = base64.b64decode(fields[2], validate=True)
    except (binascii.Error, ValueError):
        return None
    patterns = tuple(fields[0].lower().split(",")) if not fields[0].startswith("|") else (fields[0],)
    return Entry(patterns=patterns, key=HostKey(kind=fields[1], blob=blob), revoked=marker == "@revoked")


def _glob_matches(pattern: str, name: str) -> bool:
    """Wildcards of ``known_hosts``: ``*`` and ``?`` only; brackets are those of ``[host]:port``."""
    regex = re.escape(pattern).replace(r"\*", ".*").replace(r"\?", ".")
    return re.fullmatch(regex, name.lower()) is not None


def _hash_matches(pattern: str, name: str) -> bool:
    """HMAC-SHA1 of the name under the salt, as ``ssh-keygen -H`` writes it: ``|1|salt|hash``."""
    try:
        salt, digest = (base64.b64decode(part, validate=True) for part in pattern.split("|")[2:4])
    except (binascii.Error, ValueError):
        return False
    return hmac.compare_digest(hmac.new(salt, name.encode(), hashlib.sha1).digest(), digest)
