"""Which verbs does ``fab`` have?"""

from __future__ import annotations

import sys
from pathlib import Path

from fleet.cli import deploy, lab, observe, overview, project, verb


@verb.verb(name="help", looks=True)
def help_() -> None:
    """Show this overview of the verbs."""
    sys.stdout.write(_overview())


ns = verb.collection((*project.VERBS, *observe.VERBS, *deploy.VERBS), default=help_, lab=lab.VERBS)


def main() -> None:
    """Run the ``fleet`` command: the same verbs, for a folder that has an inventory and no fabfile."""
    verb.main(ns, overview=_overview)


def _overview() -> str:
    return overview.page(verb.summaries(ns), program=Path(sys.argv[0]).name)
