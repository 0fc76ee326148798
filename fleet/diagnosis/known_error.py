"""What does a tool's error message mean, and how is the error fixed? One such message, as a value."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

from fleet.diagnosis.packages import PACKAGES

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

_NOWHERE: Mapping[str, str] = MappingProxyType({})


class KnownError(NamedTuple):
    """An error, as tools print it.

    ``what`` and ``cure`` may contain the groups of ``pattern`` that matched: {0} is the first of them, {package} the Debian
    package of the command {0}. ``during`` has other cures for the verbs in which the usual one makes no sense, such as
    those that it names. ``vague``: the output says only that something failed, and the reason is elsewhere, such as in
    the journal.
    """

    pattern: str
    what: str
    cure: str
    during: Mapping[str, str] = _NOWHERE
    vague: bool = False

    def clause(self, groups: Sequence[str]) -> str:
        """What happened; ``groups`` are those of the pattern, at least two."""
        return self.what.format(*groups)

    def cure_during(self, verb: str, groups: Sequence[str]) -> str:
        """How to fix it, for a user who runs ``verb``."""
        return self.during.get(verb, self.cure).format(*groups, package=PACKAGES.get(groups[0], ""))
