"""Which verbs does ``fab`` have?"""

from __future__ import annotations

from fleet.cli import deploy, lab, observe, verb

ns = verb.collection((*observe.VERBS, *deploy.VERBS), lab=lab.VERBS)


def main() -> None:
    """The ``fleet`` command: the same verbs, for a folder that has an inventory and no fabfile."""
    verb.main(ns)
