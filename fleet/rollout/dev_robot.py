"""What does `fab dev` do with one robot? It holds the stack in dev, and brings what the robot lacks, whenever that changes."""

from __future__ import annotations

import hashlib
import threading
import time
from typing import TYPE_CHECKING

from fleet import terminal
from fleet.diagnosis.explain import explain
from fleet.errors import CommandFailed, FleetError, LinkLost, NotReady, TimedOut, Unreachable
from fleet.onboard.exit_codes import BROKEN_OFF, BUSY
from fleet.plan import dev_steps, watch
from fleet.plan.outcome import Outcome
from fleet.plan.readiness import ready
from fleet.provision import steps as provisioning
from fleet.rollout.dev_hold import Hold
from fleet.rollout.stream import Lines

if TYPE_CHECKING:
    from fleet.config.watch import Hook
    from fleet.plan.watch import State, Work
    from fleet.robot.facts import Facts
    from fleet.rollout.dev import Session
    from fleet.rollout.link import Link
    from fleet.rollout.sync_archive import Archive
    from fleet.ssh.session import Session as Connection

_PAUSE = 2.0
"""Seconds between two attempts to reach a robot that is away."""

_AGAIN = 30.0
"""Seconds after which a sync that failed is tried again, if no file changes before."""

_SLOWEST = 20_000
"""Bytes per second that an upload must reach; 300 s more are for the robot's own work, such as a slow stop."""

_LONGEST_HOOK = 60.0
"""Seconds for a command of `sync+exec`."""

_ONE_PERSON = "one person at a time: ask them to leave it, or choose other robots; a lost connection counts for a minute"


def attend(link: Link, *, session: Session) -> Outcome:
    """Keep a robot up to date until Ctrl-C, or until somebody brings it back to a release."""
    return _Robot(link, session).run()


class _Robot:
    """One robot while `fab dev` runs."""

    def __init__(self, link: Link, session: Session) -> None:
        self._link = link
        self._session = session
        self._target = session.targets[link.robot.name]
        self._release = ""
        self._generation = session.generation
        self._warned = False
        self._shown = ""
        self._away = False
        self._unshipped = ""
        self._due: dict[tuple[str, Hook], None] = {}
        self._baseline: tuple[State, ...] = ()
        self._told: set[str] = set()

    def run(self) -> Outcome:
        """Reach the robot again and again. What only a person can cure ends it."""
        name = self._link.robot.name
        while not self._link.closed.is_set():
            pause = _PAUSE
            try:
                self._ship()
                if ended := self._attend():
                    return Outcome(robot=name, status="done", summary=f"is not in dev any more: {ended}")
                pause = 0.0  # there is a newer build
            except (LinkLost, Unreachable, TimedOut) as problem:
                if self._link.closed.is_set():
                    break
                self._away = True
                self._status(f"away ({problem.what}); it gets all changes when it is back")
            except CommandFailed as problem:
                if problem.code == BUSY:
                    raise CommandFailed(problem.what, cure=_ONE_PERSON, code=BUSY) from None
                if problem.code != BROKEN_OFF:
                    raise
            self._link.reconnect()
            self._link.closed.wait(pause)
        return Outcome(robot=name, status="skipped", reason="interrupted by Ctrl-C")

    def _ship(self) -> None:
        """Bring the robot to the newest build, if it has missed one."""
        with self._session.changed:
            ship, generation = self._session.ship, self._session.generation
        if ship is None or generation == self._generation:
            return
        outcome = ship(self._link)
        if outcome.status == "unreachable":
            raise Unreachable(outcome.reason)
        self._generation, self._release = generation, ""
        self._unshipped = "" if outcome.good else "the new images are not shipped"
        if not outcome.good:
            for text in (outcome.reason, outcome.cure):
                self._note(text)

    def _attend(self) -> str:
        """Hold the stack in dev, and sync. Returns how dev has ended, or "" if there is a newer build."""
        if not self._away:
            self._status("look at the robot")
        facts = self._link.facts()
        self._away = False
        self._begin(facts)
        argv = dev_steps.hold(
            self._target.stack, self._release, session=self._session.name, request=self._target.request
        )
        hold = Hold(self._link.session, argv, changed=self._session.changed)
        hold.start()
        since = f"{facts.host.clock:.0f}"  # what is said before the logs are there is not lost
        threading.Thread(target=self._logs, args=(self._link.session, since), daemon=True).start()
        return self._keep(hold)

    def _begin(self, facts: Facts) -> None:
        """Check that the robot runs the release that files are to be brought into."""
        robot, stack = self._link.robot, self._target.stack
        ready(facts, robot=robot)
        there = facts.fleet.stacks.get(stack)
        if there is None or not there.current or not there.containers:
            cure = f"`fab build --hosts {robot.name}` and `fab ship --hosts {robot.name}`, then `fab dev`"
            raise NotReady(f"no release of {stack} runs on it", cure=cure)
        if self._release and there.current != self._release:
            cure = "if that was meant so: `fab dev` again"
            raise NotReady(
                f"release {there.current} has taken the place of {self._release} meanwhile", cure=cure
            )
        self._release = there.current
        unit = hashlib.sha256(provisioning.finish_unit(facts.login.name).encode()).hexdigest()
        if facts.docker.finish_unit != unit and not self._warned:
            self._warned = True
            self._note(
                "after a reboot it keeps the synced files: `fab provision` makes it go back to its release then"
            )

    def _keep(self, hold: Hold) -> str:
        """Sync whenever the robot lacks something, and show how its containers are."""
        seen, again, synced = -1, float("inf"), self._unshipped or "in step"
        told = hold.states
        while True:
            with self._session.changed:
                self._session.changed.wait_for(
                    lambda: hold.over or self._session.version != seen or hold.states != told,  # noqa: B023  called here
                    timeout=max(0.0, min(again - time.monotonic(), _AGAIN)),
                )
                version, behind = self._session.version, self._session.generation != self._generation
            if hold.over:
                return hold.end()
            if behind:
                return ""
            if version != seen or time.monotonic() >= again:
                seen, again = version, float("inf")
                try:
                    synced = self._sync(hold) or synced
                except CommandFailed as problem:
                    if problem.code in (BROKEN_OFF, BUSY):
                        raise
                    again, synced = time.monotonic() + _AGAIN, f"not synced: {problem.what.splitlines()[0]}"
                    self._once(
                        f"{problem}\nthe next save or {_AGAIN:.0f} s try again; `fab dev --end` ends dev"
                    )
            told = hold.states
            self._show(synced, hold)

    def _show(self, synced: str, hold: Hold) -> None:
        """Show the robot's line; once for each trouble, the last lines of the container's log."""
        now = hold.states
        if not (trouble := watch.trouble(now, self._baseline)):
            self._told.clear()
            self._status("; ".join(filter(None, (synced, watch.summary(now)))))
            return
        self._status(f"{synced}; {trouble}")
        lines = "".join(f"\n  {service}: {text}" for service, text in hold.said)
        cure = f"`fab dev --end --hosts {self._link.robot.name}` brings release {self._release} back"
        self._once(f"{trouble}{lines}\ncorrect the file and save it, or {cure}", about=trouble)

    def _sync(self, hold: Hold) -> str:
        """Bring what the robot lacks. Returns what was done."""
        work, tree = self._session.work(self._target.rules, hold.has)
        self._due |= dict.fromkeys(work.hooks)
        if not work.changes:
            self._run_hooks()  # a connection was lost before they had run
            return ""
        began = time.monotonic()
        try:
            archive = self._session.archive(work, tree)
        except OSError as problem:  # it is being written just now: the next look comes in a moment
            what = f"{problem.filename or 'a file'} cannot be read: {problem.strerror or problem}"
            raise CommandFailed(what, code=1) from None
        self._baseline = hold.states
        hold.forget(archive.changes)
        self._upload(archive, work, offset=hold.parts.pop(archive.name, 0))
        hold.remember(archive.changes)
        self._run_hooks()
        restarted = f", {' and '.join(work.restart)} restarted" if work.restart else ""
        return f"synced {_files(len(work.changes))}{restarted} in {time.monotonic() - began:.1f} s"

    def _upload(self, archive: Archive, work: Work, *, offset: int) -> None:
        """Send an archive from a byte on, and let the robot bring it into its containers."""
        name, progress = self._link.robot.name, self._session.progress
        self._shown = ""
        progress.step_started(name, f"sync {_files(len(work.changes))}", archive.size - offset)
        argv = dev_steps.sync(
            self._target.stack,
            session=self._session.name,
            name=archive.name,
            size=archive.size,
            offset=offset,
            restart=work.restart,
        )
        result = self._link.session.run(
            argv,
            feed=archive.chunks(offset),
            limit=300 + archive.size / _SLOWEST,
            on_sent=lambda count: progress.bytes_sent(name, count),
        )
        for line in result.output.splitlines():
            if line.startswith("note:"):
                self._once(line.removeprefix("note:").strip())
        if result.code:
            raise _failed(result.errors or result.output, result.code)

    def _run_hooks(self) -> None:
        for service, hook in tuple(self._due):
            argv = dev_steps.hook(self._target.stack, self._release, service, hook)
            result = None
            try:
                result = self._link.session.run(argv, limit=_LONGEST_HOOK)
            except TimedOut:
                self._note(f"{service}: `{hook.command[0]}` has not ended after {_LONGEST_HOOK:.0f} s")
            del self._due[service, hook]  # if the connection was lost, it stays due
            if result and result.code:
                text = (result.errors or result.output).strip()[-1000:]
                self._note(f"{service}: `{hook.command[0]}` ended with code {result.code}: {text}")

    def _logs(self, session: Connection, since: str) -> None:
        """Print the log lines of the containers while the connection lasts."""
        name = self._link.robot.name
        lines = Lines(lambda text: self._session.printer(name, text))
        while not self._link.closed.is_set():
            argv = dev_steps.logs(self._target.stack, self._release, since=since)
            try:
                session.run(argv, feed=None, limit=None, on_output=lines.on_output)
            except FleetError:
                return
            since = "1s"
            time.sleep(1.0)

    def _status(self, text: str) -> None:
        if text != self._shown:
            self._shown = text
            self._session.progress.step_started(self._link.robot.name, terminal.plain(text), None)

    def _note(self, text: str) -> None:
        for line in text.splitlines():
            self._session.progress.note(self._link.robot.name, terminal.plain(line))

    def _once(self, text: str, *, about: str = "") -> None:
        """Say something that is not said again before all is well."""
        if (about or text) not in self._told:
            self._told.add(about or text)
            self._note(text)


def _files(count: int) -> str:
    return "1 file" if count == 1 else f"{count} files"


def _failed(text: str, code: int) -> CommandFailed:
    what, cure = explain(text, code=code, verb="dev")
    return CommandFailed(
        terminal.plain(what) or f"the sync ended with code {code}", cure=cure, code=code, output=text
    )
