from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet import onboard
from fleet.plan import prune
from fleet.plan.step import Plan
from fleet.robot.facts import StackFacts
from fleet.robot.image_store import ImageStore
from tests.support.samples import PI, change, facts

if TYPE_CHECKING:
    from fleet.robot.facts import Facts

FINGERPRINTS = {name: str(number) * 12 for number, name in enumerate("abcdef", start=1)}


def tag(release: str, repository: str = "talker") -> str:
    """The image that a release of one letter runs."""
    return f"{repository}:fleet-{FINGERPRINTS[release]}"


def told(*releases: str, outcome: str = "done") -> tuple[str, ...]:
    return tuple(f"2026-11-23T12:00:00Z\tship\t{name}\ttim@desktop\t{outcome}" for name in releases)


def robot(
    releases: str,
    *,
    current: str = "",
    ran: str | None = None,
    pins: dict[str, tuple[str, ...]] | None = None,
) -> Facts:
    """Each release has an image of its own; they ran in the order of ``ran``, the last one is current."""
    order = releases if ran is None else ran
    seen = facts(
        current=current or order[-1:],
        releases=tuple(sorted(releases)),
        history=told(*order),
        images=dict.fromkeys((tag(name) for name in releases), "identity"),
    )
    known = {name: (tag(name),) for name in releases} if pins is None else pins
    return change(seen, image_store=ImageStore(pins={f"talker/{name}": of for name, of in known.items()}))


def removed(
    seen: Facts, *, keep: int = 3, shipped: str = "", images: tuple[str, ...] = ()
) -> tuple[str, str]:
    """The releases and the images that are removed, a letter for each."""
    steps = prune.after(seen, stack="talker", keep=keep, shipped=shipped, images=images)
    words = [word for step in steps for word in step.argv[6:]]
    gone, _, old = " ".join(words).partition("--")
    letters = {tag(name): name for name in FINGERPRINTS}
    return "".join(gone.split()), "".join(letters[name] for name in old.split())


@pytest.mark.parametrize(
    ("releases", "ran", "current", "keep", "gone"),
    [
        ("", "", "", 3, ""),
        ("a", "a", "a", 3, ""),
        ("abc", "abc", "c", 3, ""),
        ("abcd", "abcd", "d", 3, "a"),
        ("abcde", "abcde", "e", 3, "ab"),
        ("abcde", "edcba", "a", 3, "de"),
        ("abcd", "abcda", "a", 3, "b"),
        ("abcd", "abcda", "a", 2, "bc"),
        ("abcd", "abcd", "a", 2, "bc"),
        ("abcd", "cd", "d", 2, "ab"),
        ("abcd", "xycd", "d", 2, "ab"),
        ("abc", "abc", "c", 0, "a"),
        ("abc", "abc", "c", 1, "a"),
        ("abc", "abc", "c", -5, "a"),
        ("abc", "ab", "x", 2, "ac"),
        ("abcd", "aaaabbbbcccd", "d", 3, "a"),
    ],
)
def test_the_newest_releases_stay(releases: str, ran: str, current: str, keep: int, gone: str) -> None:
    """By when they ran last, what never ran being the oldest; their images go with those that go, never fewer than two stay."""
    assert removed(robot(releases, ran=ran, current=current), keep=keep) == (gone, gone)


def test_a_release_that_failed_has_not_run() -> None:
    """It is older than all that did."""
    seen = change(robot("abcd", ran="abc"), history=(*told("a", "b", "c"), *told("d", outcome="failed: x")))
    assert removed(seen, keep=3) == ("d", "d")


@pytest.mark.parametrize(
    ("releases", "keep", "gone"),
    [("abc", 3, "a"), ("abc", 2, "ab"), ("abcd", 3, "ab"), ("c", 2, ""), ("", 3, "")],
)
def test_after_a_ship_the_new_release_counts(releases: str, keep: int, gone: str) -> None:
    """The robot was looked at before: what was current is the one before it now, and the way back."""
    seen = robot(releases)
    assert removed(seen, keep=keep, shipped="f", images=(tag("f"),)) == (gone, gone)


def test_an_image_that_a_release_needs_stays() -> None:
    """Releases share images when only their values differ; the one that was shipped just now has some, too."""
    shared = {"a": (tag("a"), tag("b")), "b": (tag("a"),), "c": (tag("c"),), "d": (tag("d"),)}
    seen = robot("abcd", pins=shared)
    assert removed(seen) == ("a", "b")
    seen = robot("abcd", pins={**shared, "a": (tag("a"),), "b": (tag("b"),)})
    assert removed(seen, shipped="f", images=(tag("a"),)) == ("ab", "b")


def test_an_image_that_no_release_needs_goes() -> None:
    """Its release was removed by hand, or never written."""
    seen = robot("ab")
    assert removed(change(seen, images={**seen.fleet.images, tag("f"): "identity"})) == ("", "f")


@pytest.mark.parametrize("unknown", ["b", "c", "d"])
def test_where_it_is_not_known_what_a_release_runs_no_image_goes(unknown: str) -> None:
    """One of those that stay could need it; what those that go run does not matter."""
    pins: dict[str, tuple[str, ...]] = {name: (tag(name),) for name in "abcd" if name != unknown}
    assert removed(robot("abcd", pins=pins)) == ("a", "")
    assert removed(robot("abcd", pins={name: (tag(name),) for name in "bcd"})) == ("a", "a")


@pytest.mark.parametrize(
    "name",
    [
        "talker:latest",
        "talker:fleet-1",
        "talker:fleet-11111111111g",
        "talker:fleet-1111111111111",
        "talker:my-fleet-111111111111",
        "fleet-111111111111",
        "<none>:<none>",
    ],
)
def test_only_names_that_fleet_made_are_removed(name: str) -> None:
    """Of other people's images nothing is known."""
    seen = robot("ab")
    assert (
        prune.after(change(seen, images={**seen.fleet.images, name: "identity"}), stack="talker", keep=3)
        == ()
    )


def test_the_command() -> None:
    """One script, which holds the robot's lock and looks again: releases first, then the images that nobody needs."""
    seen = robot("abcd")
    image = "me:5000/my/talker:fleet-0123456789ab"
    seen = change(seen, images={**seen.fleet.images, image: "identity"})
    (step,) = prune.after(seen, stack="talker", keep=2)
    assert step.argv == (
        *("sh", "-c", onboard.text("remove_releases.sh"), "remove_releases"),
        *("talker", "3600", "a", "b", "--", image, tag("a"), tag("b")),
    )
    assert (step.title, step.harmless) == ("remove 2 old releases and 3 old images", True)


def test_images_of_other_stacks_stay() -> None:
    """What another stack's releases run is not old, however few of this stack stay."""
    seen = robot("abcd")
    stacks = {**seen.fleet.stacks, "other": StackFacts(releases=("x",))}
    pins = {**seen.fleet.image_store.pins, "other/x": (tag("a"),)}
    seen = change(replace(seen, fleet=replace(seen.fleet, stacks=stacks)), image_store=ImageStore(pins=pins))
    assert removed(seen) == ("a", "")


def test_the_plan_of_the_verb() -> None:
    """What it removes is its summary."""
    seen = robot("abcd")
    assert prune.plan(robot=PI, facts=seen, stacks=("talker",), keep=3) == Plan(
        robot="pi1",
        summary="remove 1 old release and 1 old image",
        verb="prune",
        steps=prune.after(seen, stack="talker", keep=3),
    )


def test_a_robot_with_nothing_old_is_unchanged() -> None:
    """No step."""
    plan = prune.plan(robot=PI, facts=robot("ab"), stacks=("talker",), keep=3)
    assert plan == Plan(robot="pi1", summary="nothing is older than its newest 3 releases")


@given(
    releases=st.lists(st.sampled_from("abcdef"), unique=True),
    ran=st.lists(st.sampled_from("abcdef")),
    known=st.sets(st.sampled_from("abcdef")),
    keep=st.integers(-1, 6),
    shipped=st.sampled_from(["", *"abcdef"]),
)
def test_never_what_runs_nor_the_way_back(
    releases: list[str], ran: list[str], known: set[str], keep: int, shipped: str
) -> None:
    """Neither the current release nor the one before it, nor the images of any release that stays."""
    pins: dict[str, tuple[str, ...]] = {name: (tag(name),) for name in known}
    seen = robot("".join(releases), ran="".join(ran), pins=pins)
    gone, old = removed(seen, keep=keep, shipped=shipped, images=(tag(shipped),) if shipped else ())
    there = {*releases, shipped}
    order = [name for name in dict.fromkeys((shipped, *reversed(ran))) if name]
    assert not set(order[:2]) & set(gone)
    assert len(set(gone)) == len(gone) <= max(0, len(there - {""}) - 1)
    assert not set(old) & (there - set(gone) & set(pins))
    if (there - set(gone) - {shipped, ""}) - set(pins):
        assert old == ""


def test_what_it_frees_is_said() -> None:
    """As Docker says it, which counts layers that others share: at most."""
    seen = robot("abcd")
    stock = replace(seen.fleet.image_store, sizes={tag("a"): 241_000_000, tag("d"): 1})
    plan = prune.plan(robot=PI, facts=change(seen, image_store=stock), stacks=("talker",), keep=3)
    assert plan.forecast == "frees 241 MB at most: layers that other images share stay"


def test_what_interrupted_commands_have_left_goes() -> None:
    """It is named in --dry."""
    left = ImageStore(leftovers=("spool/aa", "receipts/b", "spool/cc", "spool/dd"))
    (step,) = prune.plan(robot=PI, facts=facts(image_store=left), stacks=["talker"], keep=3).steps
    assert step.title == "remove what interrupted commands have left (spool/aa, receipts/b, spool/cc, ...)"
    assert step.argv[-4:] == left.leftovers
