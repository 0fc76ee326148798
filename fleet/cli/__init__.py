"""Which verbs does ``fab`` have?"""

from __future__ import annotations

import sys

from fleet.cli import (
    build,
    bundle,
    card,
    ci,
    completions,
    console,
    deploy,
    dev,
    find,
    lab,
    observe,
    overview,
    program,
    project,
    push,
    selection,
    verb,
)


@verb.verb(name="help", looks=True)
def help_() -> None:
    """Show this overview of the verbs."""
    sys.stdout.write(_overview())


@verb.verb(
    {
        "shell": "bash, zsh or fish; default: the one of $SHELL",
        "install": "write it to the place where the shell looks for it",
        "names": "print the names of the inventory instead: hosts or stack",
    },
    looks=True,
)
def completion(shell: str = "", install: bool = False, names: str = "", inventory: str = "") -> None:
    """Print what makes the Tab key complete verbs and names.

    `fleet completion bash` prints the script, --install writes it to a file. Verbs and flags are those of this version of
    fleet; robots, groups and stacks are read from the inventory when you press Tab. After an update, install it again.
    """
    screen = console.Screen()
    if names:
        screen.lines(completions.names(names, inventory))
        return
    shell = completions.shell(shell)
    texts = completions.Verbs(summaries=verb.summaries(ns), flags=verb.flags(ns))
    script = completions.script(shell, texts)
    if install:
        for line in completions.install(shell, script):
            screen.say(line)
    else:
        sys.stdout.write(script)


ns = verb.collection(
    (
        completion,
        *project.VERBS,
        *card.VERBS,
        *find.VERBS,
        *observe.VERBS,
        *build.VERBS,
        *deploy.VERBS,
        *dev.VERBS,
        *bundle.VERBS,
        *push.VERBS,
    ),
    default=help_,
    lab=lab.VERBS,
    ci=ci.VERBS,
)


def main() -> None:
    """Run the ``fleet`` command: the same verbs, for a folder that has an inventory and no fabfile."""
    verb.main(ns, overview=_overview, words={"completion": "--shell"})


def _overview() -> str:
    return overview.page(verb.summaries(ns), program=program.name(), new=not selection.found())
