from __future__ import annotations

import pytest

from fleet.config.watch import Action, Hook, Rule
from fleet.plan.watch import (
    GONE,
    Change,
    Entry,
    State,
    Wanted,
    Work,
    changed,
    idle,
    initial,
    rebuilds,
    states,
    summary,
    trouble,
    wanted,
    work,
)

ONE, TWO = Entry(digest="1"), Entry(digest="2")
HUP = Hook(command=("kill", "-HUP", "1"))


def rule(
    action: Action, path: str = "/p/src", target: str = "/app", *, service: str = "node", first: bool = False
) -> Rule:
    hook = HUP if action == "sync+exec" else None
    return Rule(service=service, action=action, path=path, target=target, initial=first, hook=hook)


def put(place: str, digest: str, source: str, *, service: str = "node") -> Change:
    return Change(verb="put", service=service, digest=digest, place=place, source=source)


def test_new_gone_and_different_files() -> None:
    """A file that was saved without a change is none of them."""
    before = {"same": ONE, "gone": ONE, "edited": ONE, "mode": ONE}
    now = {"same": ONE, "edited": TWO, "new": ONE, "mode": Entry(digest="1", mode=0o755)}
    assert changed(before, now) == {"gone", "edited", "new", "mode"}


def test_only_initial_sync_takes_what_was_there_before() -> None:
    """Compose's default is to wait for the first change."""
    tree = {"/p/src/a": ONE, "/p/lib/b": ONE}
    assert initial([rule("sync"), rule("sync", "/p/lib", first=True)], tree) == {"/p/lib/b"}


def test_a_rule_that_no_file_belongs_to() -> None:
    """Its folder is empty, or all in it is ignored."""
    every = [rule("sync"), rule("sync", "/p/lib")]
    assert idle(every, {"/p/src/a": ONE}) == (every[1],)


def test_a_new_image_is_asked_for_by_name() -> None:
    """The first file in the order of names, for the message."""
    named = [rule("sync"), rule("rebuild", "/p/Dockerfile"), rule("rebuild", "/p/docker")]
    assert rebuilds(named, ["/p/src/a", "/p/docker/x", "/p/Dockerfile"]) == "/p/Dockerfile"
    assert rebuilds(named, ["/p/src/a"]) == ""


def test_where_a_file_goes_and_what_follows() -> None:
    """All rules that are about it count; for one place, all that they ask for."""
    every = [rule("sync+exec"), rule("sync+restart"), rule("restart", service="web"), rule("rebuild")]
    assert wanted(every, ["/p/src/a"], {"/p/src/a": ONE}) == {
        ("node", "/app/a"): Wanted(source="/p/src/a", digest="1", syncs=True, restart=True, hooks=(HUP,)),
        ("web", "restart:/p/src/a"): Wanted(source="/p/src/a", digest="1", syncs=False, restart=True),
    }
    assert wanted([rule("sync")], ["/p/src/a"], {}) == {
        ("node", "/app/a"): Wanted(source="", digest=GONE, syncs=True)
    }


def asked(*rules: Rule, tree: dict[str, Entry], touched: set[str], has: dict[tuple[str, str], str]) -> Work:
    return work(wanted(rules, touched, tree), wanted(rules, tree, tree), has)


def test_a_robot_gets_what_has_changed_and_it_does_not_have() -> None:
    """Once: then it has it."""
    tree = {"/p/src/a": TWO, "/p/src/b": ONE, "/p/src/c": ONE}
    first = asked(rule("sync+restart"), tree=tree, touched={"/p/src/a", "/p/src/gone"}, has={})
    gone = Change(verb="gone", service="node", digest=GONE, place="/app/gone")
    assert first == Work(changes=(put("/app/a", "2", "/p/src/a"), gone), restart=("node",))
    has = {("node", one.place): one.digest for one in first.changes}
    assert asked(rule("sync+restart"), tree=tree, touched={"/p/src/a", "/p/src/gone"}, has=has) == Work()


def test_what_an_earlier_dev_has_synced_is_brought_up_to_date() -> None:
    """Files that were edited, or removed, while nobody followed them; the others stay."""
    tree = {"/p/src/a": TWO, "/p/src/b": ONE}
    has = {
        ("node", "/app/a"): "1",
        ("node", "/app/b"): "1",
        ("node", "/app/removed"): "1",
        ("node", "/app/x"): GONE,
    }
    assert asked(rule("sync"), tree=tree, touched=set(), has=has) == Work(
        changes=(
            put("/app/a", "2", "/p/src/a"),
            Change(verb="gone", service="node", digest=GONE, place="/app/removed"),
        )
    )


def test_a_file_that_only_restarts_is_noted_and_not_sent() -> None:
    """So a robot that was away restarts too, once."""
    tree = {"/p/src/a": ONE}
    first = asked(rule("restart"), tree=tree, touched={"/p/src/a"}, has={})
    mark = Change(verb="mark", service="node", digest="1", place="restart:/p/src/a", source="/p/src/a")
    assert first == Work(changes=(mark,), restart=("node",))
    assert str(mark) == "mark node 1 restart:/p/src/a"
    has = {("node", mark.place): "1"}
    assert asked(rule("restart"), tree=tree, touched={"/p/src/a"}, has=has) == Work()


def test_a_command_runs_once_for_many_files() -> None:
    """As `docker compose watch` does."""
    tree = {"/p/src/a": ONE, "/p/src/b": ONE}
    assert asked(rule("sync+exec"), tree=tree, touched=set(tree), has={}).hooks == (("node", HUP),)


WELL = State(service="node", state="running", health="healthy")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            "node,running,0,0,healthy web,exited,3,1,none",
            (WELL, State(service="web", state="exited", code=3, restarts=1)),
        ),
        ("", ()),
        ("nonsense a,b,c,d,e ,,,,", ()),
    ],
)
def test_states_are_read(text: str, expected: tuple[State, ...]) -> None:
    """Words that are no state are passed over."""
    assert states(text) == expected


@pytest.mark.parametrize(
    ("state", "before", "text"),
    [
        (WELL, 0, ""),
        (
            State(service="node", state="running", restarts=2, code=1),
            0,
            "node ends again and again (exit code 1)",
        ),
        (State(service="node", state="running", restarts=2), 2, ""),
        (
            State(service="node", state="restarting", code=1, restarts=2),
            2,
            "node ends again and again (exit code 1)",
        ),
        (State(service="node", state="exited", code=137), 0, "node has ended with code 137"),
        (State(service="node", state="exited"), 0, ""),
        (State(service="node", state="running", health="unhealthy"), 0, "node is unhealthy"),
    ],
)
def test_trouble_is_what_a_person_must_see(state: State, before: int, text: str) -> None:
    """A restart that was there before the sync is not its fault; a one-shot that ended well is no trouble."""
    assert trouble((state,), (State(service="node", state="running", restarts=before),)) == text


def test_a_summary_of_containers() -> None:
    """Health, or the state without a health check."""
    assert summary((WELL, State(service="web", state="running"))) == "node healthy, web running"
