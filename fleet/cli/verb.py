"""How does a function become a verb of ``fab``? The only module that imports Fabric and Invoke.

Two things go another way than in Fabric: ``fab -H NAME ship`` is refused, because Fabric would run the task with its
default robots, and what follows ``--`` belongs to the task before it. ``fabric.yaml`` names `Executor` for that.
"""

from __future__ import annotations

import inspect
import os
import sys
from functools import wraps
from typing import TYPE_CHECKING, Any

from fabric import Config, Connection, task
from fabric.executor import Executor as FabricExecutor
from fabric.main import Fab
from invoke.collection import Collection
from invoke.exceptions import Exit

from fleet import __version__
from fleet.errors import FleetError

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterable, Mapping

HELP = {
    "hosts": "robots, groups and wildcards, comma separated; default: all",
    "dry": "show what would be done, and change nothing",
    "json": "print the result as JSON",
    "stack": "only this stack, by its Compose project name; default: all of the robots' stacks",
    "inventory": "the inventory file; default: $FLEET_INVENTORY, or the nearest inventory.yaml",
}


def verb(
    texts: Mapping[str, str] | None = None, *, name: str | None = None, looks: bool = False
) -> Callable[[Callable[..., int | None]], Any]:
    """Make a function a task of ``fab``; ``texts`` say what its own flags mean.

    What the function returns becomes the exit code, and our errors one sentence with theirs. A flag ``dry`` is also
    set by Invoke's own ``--dry``, wherever that stands on the line; a verb without it is refused then, unless it
    ``looks`` only.
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
                raise Exit("this verb has no --dry, and so nothing was done", code=2)
            _finish(body, {key: _value(key, said, numbers) for key, said in options.items()})

        context = inspect.Parameter("c", inspect.Parameter.POSITIONAL_OR_KEYWORD)
        # Invoke would fall over a number that is none, so it is given text, and numbers are read here.
        numbers = {key for key, flag in signature.parameters.items() if type(flag.default) is int}
        parameters = [context, *(_as_text(flag) for flag in signature.parameters.values())]
        guarded.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
        known = {name: text for name, text in HELP.items() if name in signature.parameters}
        flags = {**known, **(texts or {})}
        return task(name=name, auto_shortflags=False, positional=[], help=flags)(guarded)

    return make


def _as_text(flag: inspect.Parameter) -> inspect.Parameter:
    return flag.replace(default=str(flag.default)) if type(flag.default) is int else flag


def _value(name: str, said: object, numbers: Container[str]) -> object:
    """What was said for a flag, as its function takes it."""
    if name not in numbers:
        return said
    if not str(said).isdecimal():
        raise Exit(f"--{name} takes a whole number, not {said}", code=2)
    return int(str(said))


def _finish(body: Callable[..., int | None], options: Mapping[str, Any]) -> None:
    """Run a verb and leave with its exit code."""
    try:
        code = body(**options)
        sys.stdout.flush()
    except FleetError as problem:
        cure = f"\n  cure: {problem.cure}" if problem.cure else ""
        raise Exit(f"{problem.what}{cure}", code=problem.exit_code) from None
    except BrokenPipeError:
        _forget_the_reader()
        code = 0
    if code:
        raise Exit(code=code)


def _forget_the_reader() -> None:
    """`fab logs | head` is not an error; Python would complain again when it flushes."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _misplaced(tasks: str, names: str) -> Exit:
    return Exit(f"--hosts comes after the task: fab {tasks.replace('_', '-')} --hosts {names}", code=2)


class Executor(FabricExecutor):  # type: ignore[misc]  # Fabric has no annotations
    """Fabric's, with ``-H`` refused, and the rest of the line given to the task that takes a command."""

    def expand_calls(self, calls: Iterable[Any], apply_hosts: bool = True) -> list[Any]:
        """See ``fabric.executor.Executor.expand_calls``."""
        if names := self.core[0].args.hosts.value:
            raise _misplaced(" ".join(str(call.called_as or call.name) for call in calls), names)
        command, self.core.remainder = self.core.remainder, ""
        expanded: list[Any] = super().expand_calls(calls, apply_hosts)
        if command:
            if not expanded or "command" not in inspect.signature(expanded[-1].task.body).parameters:
                raise Exit("only `run` takes a command after `--`: fab run --hosts NAMES -- COMMAND", code=2)
            expanded[-1].kwargs["command"] = command
        return expanded


def collection(verbs: Iterable[Any], **groups: Iterable[Any]) -> Collection:
    """The verbs as ``fab`` lists them; each of ``groups`` under its name (``lab.up``)."""
    whole = Collection(*verbs)
    for name, members in groups.items():
        whole.add_collection(Collection(name, *members))
    return whole


def main(verbs: Collection) -> None:
    """Run as a program of its own, without a fabfile."""
    program = Fab(
        name="fleet",
        binary="fleet",
        version=__version__,
        namespace=verbs,
        executor_class=Executor,
        config_class=Config,
    )
    try:
        try:
            program.run()  # which ends with SystemExit
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        _forget_the_reader()
