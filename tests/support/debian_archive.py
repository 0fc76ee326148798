"""Debian's base images for the tests."""

from __future__ import annotations

from fleet.images import debian_base

SUITE = "bookworm"


def base(platform: str) -> str:
    """The name of the base for a platform."""
    return debian_base.ensure(SUITE, platform, say=print)
