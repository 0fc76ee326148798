"""How do saved files reach the containers of many robots at once?

One thread looks at the files (`fleet.rollout.saved_files`) and builds images; each robot has a thread of its own
(`fleet.rollout.dev_robot`), which compares what the desktop has with what its robot has.
"""

from __future__ import annotations

import secrets
import tempfile
import threading
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from fleet.errors import FleetError
from fleet.plan import watch
from fleet.rollout import dev_robot
from fleet.rollout.pool import each
from fleet.rollout.saved_files import SavedFiles
from fleet.rollout.sync_archive import Archives

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from fleet.config.inventory import Robot
    from fleet.config.watch import Rule
    from fleet.plan.compose_steps import Request
    from fleet.plan.outcome import Outcome
    from fleet.plan.watch import Place, Tree, Wanted, Work
    from fleet.rollout.link import Link
    from fleet.rollout.progress import Progress
    from fleet.rollout.sync_archive import Archive

    Ship = Callable[[Link], Outcome]
    Rebuild = Callable[[], Ship]


@dataclass(frozen=True, kw_only=True)
class Target:
    """What one robot follows: a stack, its rules, and who asks."""

    stack: str
    rules: tuple[Rule, ...]
    request: Request


class Session:
    """One `fab dev`: the files of this computer as they are, which of them have changed, and the newest build.

    ``changed`` is notified about all of that, and by each robot about itself. ``version`` counts the changes of files,
    ``generation`` the builds; ``ship`` brings a robot to the newest one.
    """

    def __init__(
        self,
        targets: Mapping[str, Target],
        *,
        archives: Archives,
        rebuild: Rebuild,
        progress: Progress,
        printer: Callable[[str, str], None],
    ) -> None:
        self.targets = targets
        self.progress = progress
        self.printer = printer
        self.name = secrets.token_hex(8)
        self.changed = threading.Condition()
        self.version = 0
        self.generation = 0
        self.ship: Ship | None = None
        self._rebuild = rebuild
        self._archives = archives
        self._rules = tuple(dict.fromkeys(rule for one in targets.values() for rule in one.rules))
        self._files = SavedFiles(self._rules, note=lambda text: progress.note("files", text))
        self._tree: Tree = self._files.look()
        self._touched = watch.initial(self._rules, self._tree)
        for rule in watch.idle(self._rules, self._tree):
            progress.note(
                "files", f"there is no file in {rule.path} to follow; `ignore:` and .dockerignore count"
            )
        self._everything: dict[tuple[Rule, ...], tuple[int, dict[Place, Wanted]]] = {}
        self._stop = threading.Event()

    @contextmanager
    def following(self) -> Iterator[None]:
        """Look at the files in a thread of its own, until the ``with`` block ends."""
        threading.Thread(target=self._follow, daemon=True).start()
        try:
            yield
        finally:
            self._stop.set()

    def work(self, rules: tuple[Rule, ...], has: Mapping[Place, str]) -> tuple[Work, Tree]:
        """What a robot lacks that has ``has``, and the files at this moment."""
        with self.changed:
            tree, touched, version = self._tree, self._touched, self.version
            known = self._everything.get(rules)
        everything = (
            known[1] if known and known[0] == version else watch.wanted(rules, tree, tree) if has else {}
        )
        if has:
            self._everything[rules] = (version, everything)
        return watch.work(watch.wanted(rules, touched, tree), everything, has), tree

    def archive(self, work: Work, tree: Tree) -> Archive:
        """The upload with the changes of ``work``, packed once for all robots."""
        return self._archives.of(work.changes, tree)

    def _follow(self) -> None:
        for _ in self._files.changes(self._stop):
            try:
                now = self._files.look()
            except FleetError as problem:
                self.progress.note("files", str(problem))
                continue
            paths = watch.changed(self._tree, now)
            if not paths:
                continue
            reason = watch.rebuilds(self._rules, paths)
            with self.changed:
                self._tree, self._touched = now, self._touched | paths
                self.version += 1
                self.changed.notify_all()
            if reason:
                self._build(reason)

    def _build(self, reason: str) -> None:
        """Make new images, which have all files as they are now, and let the robots ship them."""
        self.progress.note("build", f"{Path(reason).name} has changed: new images, then a ship")
        try:
            ship = self._rebuild()
        except (FleetError, OSError) as problem:
            self.progress.note("build", f"failed: {problem}")
            self.progress.note(
                "build", "the robots keep what they have; save the file again when it is corrected"
            )
            return
        with self.changed:
            self.ship = ship
            self.generation += 1
            self.version += 1
            self._touched = watch.initial(self._rules, self._tree)
            self.changed.notify_all()


def follow(
    robots: Sequence[Robot],
    targets: Mapping[str, Target],
    *,
    rebuild: Rebuild,
    progress: Progress,
    printer: Callable[[str, str], None],
) -> tuple[Outcome, ...]:
    """Bring saved files into the containers of each robot until Ctrl-C. Returns the robots' outcomes.

    Raises:
        DesktopError: the rules are about too many files.

    """
    with tempfile.TemporaryDirectory(prefix="fleet-dev-") as folder:
        archives = Archives(Path(folder))
        session = Session(targets, archives=archives, rebuild=rebuild, progress=progress, printer=printer)
        with session.following():
            return each(
                robots, partial(dev_robot.attend, session=session), progress=progress, at_once=len(robots)
            )
