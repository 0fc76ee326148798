from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from fleet.config.project_files import File
from fleet.errors import NotReady
from fleet.images.image import Image
from fleet.plan import compose_steps, ship
from fleet.plan.compose_steps import Request
from fleet.plan.delivery import Delivery
from fleet.plan.step import Plan, Step
from fleet.robot.facts import Dev
from fleet.transfer.delivery import stream
from tests.support.samples import PI, TALKER, change, container, facts, release, stack

if TYPE_CHECKING:
    from fleet.config.inventory import Robot
    from fleet.robot.facts import Facts
    from fleet.robot.release import Release

NEW = release()
HOME = "/home/pi"
REQUEST = Request(by="tim@desktop", run="run")
HAS_IMAGE = {TALKER.shipped_as: TALKER.identity}
WRITE = compose_steps.write(NEW, home=HOME)
CHECK = Step(
    title="let the robot's Compose check the release",
    argv=compose_steps.compose("talker", NEW.id, "config", "--quiet"),
    limit=30.0,
    harmless=True,
    resumes=True,
    cure="the robot's Compose may be too old for the file: `fab status` shows its version",
)
LOAD, PROVE = stream((TALKER,), facts=facts(disk_free=10**12)).steps


def shipped(seen: Facts, *, robot: Robot = PI) -> Plan:
    return planned(release(robot=robot), seen, robot=robot)


def planned(made: Release, seen: Facts, *, robot: Robot = PI) -> Plan:
    """The plan for a release whose images are streamed."""
    missing = ship.missing(made, seen)
    delivery = stream(missing, facts=seen) if missing else Delivery()
    return ship.plan(robot=robot, release=made, facts=seen, delivery=delivery, request=REQUEST)


def rolled(seen: Facts, *, to: str = "") -> Plan:
    return ship.rollback(robot=PI, stack="talker", facts=seen, to=to, request=REQUEST)


def up(of: str, *, verb: compose_steps.Verb = "ship", seen: str = "") -> Step:
    return compose_steps.swap(verb, "talker", of, seen=seen, request=REQUEST)


def told(*releases: str, outcome: str = "done", verb: str = "ship") -> tuple[str, ...]:
    """Lines of history, oldest first."""
    return tuple(f"2026-11-23T12:00:00Z\t{verb}\t{name}\ttim@desktop\t{outcome}" for name in releases)


def running(of: str = NEW.id) -> Facts:
    """A robot that runs a release well, with this test's image and an older release beside it."""
    seen = facts(
        current=of,
        releases=tuple(dict.fromkeys((of, "old"))),
        services=("talker",),
        containers=(container(of),),
        images=HAS_IMAGE,
        history=told("old", of),
    )
    return change(seen, checksum=NEW.checksum(HOME))


def test_the_first_ship() -> None:
    """Everything that can fail without touching what runs comes first; the swap is the robot's own work."""
    assert shipped(facts()) == Plan(
        robot="pi1",
        summary=f"release {NEW.id}",
        verb="ship",
        steps=(WRITE, CHECK, LOAD, PROVE, up(NEW.id)),
        forecast="sends 241 MB, whole images",
        transfer="whole images",
    )


def test_releases_of_the_first_version_are_taken_over() -> None:
    """Before anything else: the release before would be out of reach otherwise."""
    assert shipped(facts(legacy="talker")).steps[:2] == (compose_steps.adopt("talker"), WRITE)


def test_an_image_that_is_there_is_not_sent_again() -> None:
    """A new environment alone ships in a moment."""
    plan = shipped(facts(images=HAS_IMAGE, current="old", releases=("old",), containers=(container("old"),)))
    assert plan.size < 100_000
    assert plan.steps == (WRITE, CHECK, up(NEW.id, seen="old"))


def test_an_image_of_the_same_name_and_another_content_is_sent() -> None:
    """A load that broke off can leave the name on something else."""
    plan = shipped(facts(images={TALKER.shipped_as: TALKER.identity.replace("a1", "bb")}))
    assert plan.steps == (WRITE, CHECK, LOAD, PROVE, up(NEW.id))


def test_a_second_ship_changes_nothing() -> None:
    """Release, images and health are as they should be: no step, and so nothing sent."""
    assert shipped(running()) == Plan(robot="pi1", summary=f"runs release {NEW.id}")


@pytest.mark.parametrize(
    "values",
    [
        {"containers": ()},
        {"containers": (container(NEW.id, state="exited"),)},
        {"containers": (container(NEW.id, health="unhealthy"),)},
        {"containers": (container(NEW.id, health="starting"),)},
        {"containers": (container("old"),)},
        {"containers": (container(NEW.id, service="other"),)},
        {"images": {}},
        {"current": "old"},
        {"journal": "swap ship x"},
        {"dev": Dev(by="tim@desktop", since="2026-11-28T12:00:00Z")},
        {"checksum": "of other files"},
    ],
)
def test_whatever_is_not_as_it_should_be_is_shipped_again(values: dict[str, object]) -> None:
    """A container that is gone or ill, an image that was pruned, a directory that somebody removed."""
    seen = change(running(), **values)
    assert shipped(seen).steps[-1:] == (up(NEW.id, seen=seen.fleet.stacks["talker"].current),)


def test_only_what_comes_after_the_harmless_steps_can_need_a_way_back() -> None:
    """A full disk or a lost image ends a ship before what runs is touched."""
    assert [step.harmless for step in shipped(facts()).steps] == [True, True, True, True, False]


def test_two_images_are_both_sent_and_proved_before_anything_starts() -> None:
    """Room is needed for both, and the summary says how much flows."""
    other = Image(
        reference="camera:latest-arm64",
        platform="linux/arm64",
        size=9_000_000,
        identity=f"sha256:{'0c' * 32}",
    )
    two = stack(a={"image": "talker"}, b={"image": "camera"})
    made = replace(release(of=two), images=(TALKER, other))
    plan = planned(made, facts())
    assert plan.size > TALKER.size + other.size
    assert [step.title for step in plan.steps] == [
        f"write release {made.id} to ~/.fleet/stacks/talker/releases/{made.id}",
        "let the robot's Compose check the release",
        f"load {TALKER.shipped_as}",
        "prove that the image arrived unchanged",
        f"load {other.shipped_as}",
        "prove that the image arrived unchanged",
        f"start release {made.id} of talker",
    ]


def test_no_room_is_needed_where_nothing_is_sent() -> None:
    """A robot with a full disk can still be given another environment, or told it is unchanged."""
    assert shipped(change(running(), disk_free=0)).steps == ()


@pytest.mark.parametrize("values", [{"docker_state": "absent"}, {"userland": "armhf"}])
def test_a_robot_that_is_not_ready_is_refused(values: dict[str, object]) -> None:
    """By shipping and by going back alike (`fleet.plan.readiness` says why)."""
    seen = change(running(), **values)
    for attempt in (shipped, rolled):
        with pytest.raises(NotReady):
            attempt(seen)


def test_an_emulating_robot_takes_the_images_it_emulates() -> None:
    """A virtual Pi is a PC that runs ARM containers."""
    assert shipped(change(facts(), machine="x86_64", userland="amd64", emulates=("qemu-aarch64",))).steps


def test_back_to_the_release_before() -> None:
    """It is all there: checked, started, made current; what runs now is where a failure goes back to."""
    plan = rolled(
        facts(current="b", releases=("a", "b"), history=told("a", "b"), containers=(container("b"),))
    )
    check = replace(CHECK, argv=compose_steps.compose("talker", "a", "config", "--quiet"))
    assert plan == Plan(
        robot="pi1",
        summary="back to release a",
        verb="rollback",
        steps=(check, up("a", verb="rollback", seen="b")),
    )


@pytest.mark.parametrize(
    ("history", "current", "releases", "target"),
    [
        (told("a", "b"), "b", "ab", "a"),
        ((*told("a", "b"), *told("a", verb="rollback")), "a", "ab", "b"),
        ((*told("a", "b"), *told("c", outcome="failed: unhealthy")), "b", "abc", "a"),
        ((*told("a", "b"), *told("c", outcome="failed: no space"), *told("d")), "d", "abcd", "b"),
        ((*told("a", "b", "b"), *told("b", verb="restart")), "b", "ab", "a"),
        (told("a", "b", "c"), "c", "ac", "a"),
        (("garbage", *told("a", "b"), "cut\tshort"), "b", "ab", "a"),
        ((*told("a"), *told("", verb="provision"), *told("b")), "b", "ab", "a"),
    ],
)
def test_which_release_was_before(history: tuple[str, ...], current: str, releases: str, target: str) -> None:
    """The last that ran and is still there: a rollback swaps, failures do not count, removed ones are passed over."""
    plan = rolled(
        facts(current=current, releases=tuple(releases), history=history, containers=(container(current),))
    )
    assert plan.summary == f"back to release {target}"


def test_nothing_to_go_back_to() -> None:
    """The first release has none before it."""
    with pytest.raises(NotReady) as caught:
        rolled(facts(current="a", releases=("a",), history=told("a", "a")))
    assert caught.value.what == "there is no earlier release to go back to"
    assert caught.value.cure == "`fab history --hosts pi1` lists them"


def test_to_a_release_by_its_name() -> None:
    """Any release that the robot has."""
    seen = facts(current="c", releases=("a", "b", "c"), history=told("a", "b", "c"))
    assert rolled(seen, to="a").summary == "back to release a"


@pytest.mark.parametrize(("releases", "cure"), [(("a", "b"), "it has: a, b"), ((), "it has: none")])
def test_to_a_release_that_is_not_there(releases: tuple[str, ...], cure: str) -> None:
    """Refused with those that are."""
    with pytest.raises(NotReady) as caught:
        rolled(facts(current="a", releases=releases, history=told("a", "b")), to="x")
    assert (caught.value.what, caught.value.cure) == ("release x is not on this robot", cure)


def test_to_the_release_that_runs_is_unchanged() -> None:
    """Nothing is restarted that is well."""
    assert rolled(running(), to=NEW.id) == Plan(robot="pi1", summary=f"runs release {NEW.id}")


@pytest.mark.parametrize("containers", [(), (container("old"),), (container(NEW.id, state="exited"),)])
def test_to_the_current_release_that_does_not_run_starts_it(containers: tuple[()]) -> None:
    """Current is what the link says; what runs is another question."""
    plan = rolled(change(running(), containers=containers), to=NEW.id)
    assert plan.steps[-1:] == (up(NEW.id, verb="rollback", seen=NEW.id),)


def test_a_conflict_can_be_decided_for_a_release_that_runs() -> None:
    """Only the robot knows whether one is open, so it is asked; without files of both sides there can be none."""
    seeds = {"tune.yaml": File(data=b"1")}
    made = replace(NEW, seeds=seeds)
    seen = change(running(), checksum=made.checksum(HOME))
    desktop = replace(REQUEST, conflict="desktop")

    def steps(of: Release, request: Request, there: Facts) -> tuple[Step, ...]:
        return ship.plan(robot=PI, release=of, facts=there, delivery=Delivery(), request=request).steps

    assert steps(made, REQUEST, seen) == ()
    assert steps(made, desktop, seen)[-1].argv[-1] == "desktop"
    assert steps(NEW, desktop, running()) == ()


def test_a_release_that_nobody_would_start_at_power_on_is_refused() -> None:
    """With `boot: systemd` the unit must be there."""
    wanted = replace(release(), boot="systemd")
    for there, words in (("", "fab provision --hosts pi1"), ("no systemd", "boot: docker")):
        with pytest.raises(NotReady, match=words):
            ship.plan(
                robot=PI, release=wanted, facts=facts(boot_unit=there), delivery=Delivery(), request=REQUEST
            )
    ship.plan(robot=PI, release=wanted, facts=facts(boot_unit="0a"), delivery=Delivery(), request=REQUEST)
