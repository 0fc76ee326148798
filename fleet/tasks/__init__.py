"""Which verbs does ``fab`` have?"""

from __future__ import annotations

from fleet import cli
from fleet.tasks import deploy, lab, look

ns = cli.collection((*look.VERBS, *deploy.VERBS), lab=lab.VERBS)


def main() -> None:
    """The ``fleet`` command: the same verbs, for a folder that has an inventory and no fabfile."""
    cli.main(ns)
