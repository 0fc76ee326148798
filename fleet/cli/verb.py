"""How does a function become a verb of ``fab``? The only module that imports Fabric and Invoke.

Three things differ from Fabric; ``fabric.yaml`` names `Executor` for them. ``fab -H NAME ship`` is refused, because
Fabric would run the task with its default robots. So are Fabric's other flags that would have no effect here. What
follows ``--`` belongs to the task before it.

``fab`` without a task runs the default task, which shows our overview. ``fab --help`` alone prints Fabric's own page:
Fabric 3.2 does that before it reads ``fabric.yaml`` or the fabfile. ``fleet --help`` shows the overview.
"""

from __future__ import annotations

import difflib
import inspect
import os
import re
import sys
from dataclasses import dataclass
from functools import wraps
from typing import TYPE_CHECKING, Any

from fabric import Config, Connection, task
from fabric.executor import Executor as FabricExecutor
from fabric.main import Fab
from invoke.collection import Collection
from invoke.exceptions import Exit, ParseError

from fleet import __version__, terminal
from fleet.cli import program
from fleet.errors import FleetError
from fleet.rollout import open_files

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterable, Mapping, Sequence

HELP = {
    "hosts": "robots, groups and wildcards, separated by commas; default: all",
    "dry": "show what would be done, and change nothing",
    "json": "print the result as JSON",
    "stack": "only this stack, by its Compose project name; default: all of the robots' stacks",
    "inventory": "the inventory file; default: $FLEET_INVENTORY, or the nearest inventory.yaml",
}


@dataclass(frozen=True, kw_only=True)
class Flag:
    """A flag of a verb: whether a value follows it, and its help."""

    takes_value: bool
    text: str


_NO_EFFECT = {
    "command-timeout": "`fab run --limit SECONDS -- COMMAND` limits a command",
    "config": "`--inventory FILE` after the task names an inventory",
    "connect-timeout": "`fab ship --retry-for SECONDS` says how long to retry a lost connection",
    "echo": "`--dry` after the task shows what would be done",
    "hide": "`2>/dev/null` hides progress",
    "identity": "set `identity_file` in the inventory",
    "prompt-for-login-password": "fleet logs in with SSH keys: `ssh-copy-id USER@ADDRESS`",
    "prompt-for-passphrase": "`ssh-add KEY` unlocks a key",
    "prompt-for-sudo-password": "`fab provision` needs sudo without a password on the robot",
    "pty": "`fab shell --hosts NAME` opens a terminal on a robot",
    "ssh-config": "fleet reads ~/.ssh/config, as `ssh` does",
    "warn-only": "when one robot fails, the others go on anyway",
}
"""Fabric's flags that change only Fabric's own connections and commands, which fleet does not use; and what to do instead."""


def verb(
    texts: Mapping[str, str] | None = None, *, name: str | None = None, looks: bool = False
) -> Callable[[Callable[..., int | None]], Any]:
    """Make a function a task of ``fab``; ``texts`` explains the flags that only this verb has.

    The function returns the exit code. An error of ours becomes one sentence and its own exit code. Invoke's ``--dry``,
    anywhere on the line, sets the flag ``dry`` too; a verb without that flag then refuses to run, unless it ``looks`` only.
    """

    def make(body: Callable[..., int | None]) -> Any:  # noqa: ANN401  Fabric's tasks have no type
        signature = inspect.signature(body)

        @wraps(body)
        def guarded(c: Any, **options: Any) -> None:  # noqa: ANN401  whatever flags the function has
            if isinstance(c, Connection):
                raise _misplaced(body.__name__, c.original_host)
            if "dry" in options:
                options["dry"] = options["dry"] or bool(c.config.run.dry)
            elif c.config.run.dry and not looks:
                raise Exit("this verb does not support --dry, so nothing was done", code=2)
            _finish(body, {key: _value(key, text, numbers) for key, text in options.items()})

        context = inspect.Parameter("c", inspect.Parameter.POSITIONAL_OR_KEYWORD)
        # Invoke shows a traceback for `--keep x`, so it gets text, and numbers are read here.
        numbers = {key for key, flag in signature.parameters.items() if type(flag.default) is int}
        parameters = [context, *(_as_text(flag) for flag in signature.parameters.values())]
        guarded.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        known = {name: text for name, text in HELP.items() if name in signature.parameters}
        flags = {**known, **(texts or {})}
        made = task(name=name, auto_shortflags=False, positional=[], help=flags)(guarded)
        made.texts = flags  # Invoke 2 forgets a flag's help when it has read it once
        return made

    return make


def _as_text(flag: inspect.Parameter) -> inspect.Parameter:
    return flag.replace(default=str(flag.default)) if type(flag.default) is int else flag


def _value(name: str, typed: object, numbers: Container[str]) -> object:
    """Convert a flag's value to the type that its function takes."""
    if name not in numbers:
        return typed
    if not str(typed).isdecimal():
        raise Exit(f"--{name.replace('_', '-')} takes a whole number, not {typed}", code=2)
    return int(str(typed))


def _finish(body: Callable[..., int | None], options: Mapping[str, Any]) -> None:
    """Run a verb and exit with its code."""
    try:
        code = body(**options)
        sys.stdout.flush()
    except FleetError as problem:
        raise _told(problem) from None
    except BrokenPipeError:
        _discard_output()
        code = 0
    except OSError as problem:
        if not (refusal := open_files.refusal(problem)):
            raise
        raise _told(refusal) from None
    if code:
        raise Exit(code=code)


def _told(problem: FleetError) -> Exit:
    cure = f"\n  cure: {problem.cure}" if problem.cure else ""
    return Exit(program.typed(terminal.plain(f"{problem.what}{cure}")), code=problem.exit_code)


def _discard_output() -> None:
    """Send output nowhere: ``fab logs | head`` is not an error, and Python would report it again at its last flush."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _misplaced(tasks: str, names: str) -> Exit:
    text = f"--hosts comes after the task: fab {tasks.replace('_', '-')} --hosts {names}"
    return Exit(program.typed(text), code=2)


class Executor(FabricExecutor):  # type: ignore[misc]  # Fabric has no annotations
    """Fabric's executor, which refuses flags without effect, and gives what follows ``--`` to the task before it."""

    def expand_calls(self, calls: Iterable[Any], apply_hosts: bool = True) -> list[Any]:
        """See ``fabric.executor.Executor.expand_calls``."""
        typed = self.core[0].args
        if names := typed.hosts.value:
            raise _misplaced(" ".join(str(call.called_as or "VERB") for call in calls), names)
        for flag, instead in _NO_EFFECT.items():
            if typed[flag].got_value:
                raise Exit(program.typed(f"--{flag} has no effect here: {instead}"), code=2)
        command, self.core.remainder = self.core.remainder, ""
        expanded: list[Any] = super().expand_calls(calls, apply_hosts)
        if command:
            if not expanded or "command" not in inspect.signature(expanded[-1].task.body).parameters:
                text = "only `run` takes a command after `--`: fab run --hosts NAMES -- COMMAND"
                raise Exit(program.typed(text), code=2)
            expanded[-1].kwargs["command"] = command
        return expanded


def collection(verbs: Iterable[Any], *, default: Any, **groups: Iterable[Any]) -> Collection:  # noqa: ANN401  Fabric's tasks have no type
    """Collect the verbs as ``fab`` lists them; each of ``groups`` under its name (``lab.up``).

    ``default`` is the verb that runs when none is typed.
    """
    whole = Collection(*verbs)
    whole.add_task(default, default=True)
    for name, members in groups.items():
        whole.add_collection(Collection(name, *members))
    return whole


def summaries(verbs: Collection) -> dict[str, str]:
    """Return the first line of each verb's help."""
    return {name: (verbs[name].__doc__ or "").partition("\n")[0] for name in verbs.task_names}


def flags(verbs: Collection) -> dict[str, dict[str, Flag]]:
    """Return the flags of each verb, as they are typed."""
    return {
        name: {
            f"--{flag.names[0]}": Flag(
                takes_value=flag.takes_value, text=verbs[name].texts.get(flag.name, "")
            )
            for flag in verbs[name].get_arguments()
        }
        for name in verbs.task_names
    }


class _Program(Fab):  # type: ignore[misc]  # Fabric has no annotations
    """Fabric's program, with our page in place of its flags."""

    def __init__(self, overview: Callable[[], str], **options: Any) -> None:  # noqa: ANN401  Fabric's own
        super().__init__(**options)
        self._overview = overview

    def print_help(self) -> None:
        """See ``invoke.Program.print_help``."""
        sys.stdout.write(self._overview())

    def parse_tasks(self) -> None:
        """See ``invoke.Program.parse_tasks``, which words what it cannot read for the authors of tasks."""
        try:
            super().parse_tasks()
        except ParseError as problem:
            raise Exit(_unreadable(problem, tuple(self.collection.task_names)), code=2) from None


def _unreadable(problem: ParseError, verbs: Sequence[str]) -> str:
    """Tell of a word or a flag that the command line cannot have. Invoke says which by its sentences only."""
    context, word = problem.context, re.search(r"'(.+)'", str(problem))
    verb = context.name if context else None
    cure = (
        f"\n  cure: `fleet {verb} --help` shows its flags"
        if verb
        else "\n  cure: `fleet --list` shows the verbs"
    )
    if flag := re.search(r"<Argument: ([\w-]+)", str(problem)):
        return f"--{flag[1].replace('_', '-')} needs a value{cure}"
    if not word:
        return f"{problem}{cure}"
    flags = [name.replace("_", "-") for name in context.as_kwargs] if context and verb else []
    if verb and not word[1].startswith("-"):
        given = f"--hosts {word[1]}" if "hosts" in flags else "--FLAG VALUE"
        text = f"{verb} takes no words without a flag, such as {word[1]}\n  cure: `fleet {verb} {given}`"
        return terminal.plain(text)
    near = difflib.get_close_matches(word[1], [f"--{name}" for name in flags] or verbs, n=1)
    hint = f"; did you mean {near[0]}?" if near else ""
    what = f"{verb} has no flag {word[1]}" if verb else f"there is no verb {word[1]}"
    return f"{terminal.plain(what)}{hint}{cure}"


def main(verbs: Collection, *, overview: Callable[[], str], words: Mapping[str, str] | None = None) -> None:
    """Run the verbs as a program of their own, without a fabfile.

    ``words`` names the verbs that take a word without a flag, and the flag that it stands for.
    """
    argv, words = list(sys.argv), words or {}
    if len(argv) > 2 and argv[1] in words and not argv[2].startswith("-"):
        argv.insert(2, words[argv[1]])
    runner = _Program(
        overview,
        name="fleet",
        binary="fleet",
        version=__version__,
        namespace=verbs,
        executor_class=Executor,
        config_class=Config,
    )
    try:
        try:
            runner.run(argv)  # which ends with SystemExit
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        _discard_output()
