"""What is a name of an image, and what are its parts?"""

from __future__ import annotations

import re

LONGEST_TAG = 128
"""Characters of a tag; this and the pattern are those of github.com/distribution/reference, reference.go."""

_HOST = r"(?:[a-zA-Z0-9](?:[a-zA-Z0-9-]*[a-zA-Z0-9])?(?:\.[a-zA-Z0-9](?:[a-zA-Z0-9-]*[a-zA-Z0-9])?)*|\[[a-fA-F0-9:]+\])"
_PART = r"[a-z0-9]+(?:(?:[._]|__|-+)[a-z0-9]+)*"
_REFERENCE = re.compile(
    rf"(?:{_HOST}(?::[0-9]+)?/)?{_PART}(?:/{_PART})*(?::\w[\w.-]{{0,127}})?(?:@sha256:[0-9a-f]{{64}})?",
    re.ASCII,
)


def is_reference(text: str) -> bool:
    """Whether Docker takes a text for the name of an image."""
    return bool(_REFERENCE.fullmatch(text)) and len(repository(text)) <= 255


def repository(reference: str) -> str:
    """The part of an image reference before its tag or digest (a colon may belong to a registry's port)."""
    name = reference.partition("@")[0]
    head, colon, tag = name.rpartition(":")
    return head if colon and "/" not in tag else name


def tag(reference: str) -> str:
    """The tag of an image reference; ``latest`` where it has none, as everywhere in Docker."""
    return reference.partition("@")[0][len(repository(reference)) + 1 :] or "latest"


def path(reference: str) -> str:
    """The path of an image in a registry: its name without the registry that it came from."""
    host, slash, rest = repository(reference).partition("/")
    return rest if slash and ("." in host or ":" in host or host == "localhost") else repository(reference)


def one_image(reference: str) -> str:
    """The reference with its tag or digest: ``talker`` alone means all tags of it to ``docker save``."""
    return reference if "@" in reference else f"{repository(reference)}:{tag(reference)}"


def full_name(reference: str) -> str:
    """The reference with the registry that a short name implies: ``talker`` is ``docker.io/library/talker``."""
    host, slash, _ = reference.partition("/")
    if slash and ("." in host or ":" in host or host == "localhost"):
        return reference
    return f"docker.io/{reference}" if slash else f"docker.io/library/{reference}"
