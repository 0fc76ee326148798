from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from fleet.config.stack import Stack
from fleet.errors import NotReady
from fleet.images.image import Image
from fleet.plan import compose_steps, ship
from fleet.plan.delivery import Delivery
from fleet.plan.step import Plan, Record, Step
from fleet.robot.release import compose
from fleet.transfer.delivery import stream
from tests.support.samples import PI, STACK, TALKER, change, container, facts, release

if TYPE_CHECKING:
    from fleet.config.inventory import Robot
    from fleet.robot.facts import Facts
    from fleet.robot.release import Release

NEW = release()
HAS_IMAGE = {TALKER.shipped_as: TALKER.identity}
WRITE = compose_steps.write(NEW)
CHECK = Step(
    title="let the robot's Compose check the release",
    argv=compose_steps.compose(PI, NEW.id, "config", "--quiet"),
    limit=30.0,
    harmless=True,
    resumes=True,
    cure="fix the Compose file or the robot's values in the inventory",
)
LOAD, PROVE = stream((TALKER,), facts=facts(disk_free=10**12)).steps


def shipped(seen: Facts, *, robot: Robot = PI) -> Plan:
    return planned(release(robot=robot), seen, robot=robot)


def planned(made: Release, seen: Facts, *, robot: Robot = PI) -> Plan:
    """The plan for a release whose images are streamed."""
    missing = ship.missing(made, seen)
    delivery = stream(missing, facts=seen) if missing else Delivery()
    return ship.plan(robot=robot, release=made, facts=seen, delivery=delivery, by="tim@desktop")


def rolled(seen: Facts, *, to: str = "") -> Plan:
    return ship.rollback(robot=PI, facts=seen, to=to, by="tim@desktop")


def up(of: str) -> Step:
    return compose_steps.start(PI, of, wait=ship.HEALTHY_WITHIN)


def told(*releases: str, outcome: str = "done", verb: str = "ship") -> tuple[str, ...]:
    """Lines of history, oldest first."""
    return tuple(f"2026-11-23T12:00:00Z\t{verb}\t{name}\ttim@desktop\t{outcome}" for name in releases)


def running(of: str = NEW.id) -> Facts:
    """A robot that runs a release well, with this test's image and an older release beside it."""
    seen = facts(
        current=of,
        releases=tuple(dict.fromkeys((of, "old"))),
        containers=(container(of),),
        images=HAS_IMAGE,
        history=told("old", of),
    )
    return change(seen, checksum=NEW.checksum)


def test_the_first_ship() -> None:
    """Everything that can fail without touching what runs comes first; with nothing before, a failure is stopped."""
    assert shipped(facts()) == Plan(
        robot="pi1",
        summary=f"release {NEW.id}",
        steps=(WRITE, CHECK, LOAD, PROVE, up(NEW.id)),
        explain=(compose_steps.last_words(PI, NEW.id),),
        recover=(compose_steps.stop(PI, NEW.id),),
        record=Record(verb="ship", release=NEW.id, by="tim@desktop"),
        forecast="sends 241 MB, whole images",
        transfer="whole images",
    )


def test_a_stack_with_a_new_name_takes_the_place_of_the_old() -> None:
    """Compose knows containers by the name of their stack; two talkers of one ROS name must not run side by side."""
    old = replace(container("old"), stack="tiny", name="tiny-talker-1")
    plan = shipped(facts(images=HAS_IMAGE, current="old", releases=("old",), containers=(old,)))
    assert [step.argv for step in plan.steps[-2:]] == [
        ("docker", "rm", "--force", "tiny-talker-1"),
        up(NEW.id).argv,
    ]
    assert plan.recover == (up("old"),)
    assert shipped(change(running(), containers=(container(NEW.id), old))).steps


def test_an_image_that_is_there_is_not_sent_again() -> None:
    """A new environment alone ships in a moment; the release before it is what a failure goes back to."""
    plan = shipped(facts(images=HAS_IMAGE, current="old", releases=("old",), containers=(container("old"),)))
    assert plan.size < 100_000
    assert plan.steps == (WRITE, CHECK, up(NEW.id))
    assert plan.recover == (up("old"),)


def test_an_image_of_the_same_name_and_another_content_is_sent() -> None:
    """A load that broke off can leave the name on something else."""
    plan = shipped(facts(images={TALKER.shipped_as: TALKER.identity.replace("aa", "bb")}))
    assert plan.steps == (WRITE, CHECK, LOAD, PROVE, up(NEW.id))


def test_a_second_ship_changes_nothing() -> None:
    """Release, images and health are as they should be: no step, and so nothing sent."""
    assert shipped(running()) == Plan(robot="pi1", summary=f"runs release {NEW.id}")


@pytest.mark.parametrize(
    "values",
    [
        {"containers": ()},
        {"containers": (container(NEW.id, state="exited"),)},
        {"containers": (container(NEW.id, status="Up 1 minute (unhealthy)"),)},
        {"containers": (container(NEW.id, status="Up 1 second (health: starting)"),)},
        {"containers": (container("old"),)},
        {"containers": (container(NEW.id, service="other"),)},
        {"images": {}},
        {"current": "old"},
        {"checksum": "of other files"},
    ],
)
def test_whatever_is_not_as_it_should_be_is_shipped_again(values: dict[str, object]) -> None:
    """A container that is gone or ill, an image that was pruned, a directory that somebody removed."""
    steps = shipped(change(running(), **values)).steps
    assert steps[-1:] == (up(NEW.id),)


def test_a_release_that_was_current_already_is_not_stopped_when_it_fails_again() -> None:
    """It may be healthy a minute later; stopped, it would never be."""
    plan = shipped(change(running(), containers=(container(NEW.id, status="Up 1 minute (unhealthy)"),)))
    assert plan.recover == ()


def test_a_current_release_that_is_gone_cannot_be_gone_back_to() -> None:
    """``current`` may point to a directory that was removed by hand."""
    assert shipped(facts(current="old", releases=())).recover == (compose_steps.stop(PI, NEW.id),)


def test_only_what_comes_after_the_harmless_steps_can_need_a_way_back() -> None:
    """A full disk or a lost image ends a ship before what runs is touched."""
    assert [step.harmless for step in shipped(facts()).steps] == [True, True, True, True, False]


def test_two_images_are_both_sent_and_proved_before_anything_starts() -> None:
    """Room is needed for both, and the summary says how much flows."""
    other = Image(reference="camera:latest-arm64", platform="linux/arm64", size=9_000_000, identity="other")
    found = {"talker": TALKER, "camera": other}
    two = Stack(name="s", text="", images={"a": "talker", "b": "camera"}, builds={})
    made = compose(robot=PI, stack=two, find=lambda name, _platform: found[name])
    plan = planned(made, facts())
    assert plan.size > TALKER.size + other.size
    assert [step.title for step in plan.steps] == [
        f"write release {made.id} to ~/.fleet/releases/{made.id}",
        "let the robot's Compose check the release",
        f"load {TALKER.shipped_as}",
        "prove that the image arrived unchanged",
        f"load {other.shipped_as}",
        "prove that the image arrived unchanged",
        f"start release {made.id}",
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
    check = replace(CHECK, argv=compose_steps.compose(PI, "a", "config", "--quiet"))
    assert plan == Plan(
        robot="pi1",
        summary="back to release a",
        steps=(check, up("a")),
        explain=(compose_steps.last_words(PI, "a"),),
        recover=(up("b"),),
        record=Record(verb="rollback", release="a", by="tim@desktop"),
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
    assert caught.value.cure == "`fab history --hosts pi1`"


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
    assert plan.steps[-1:] == (up(NEW.id),)


def test_the_robots_own_variables_are_unset_on_every_command() -> None:
    """Compose would take a login's TALKER_RATE before that of ``.env``."""
    robot = PI.model_copy(update={"environment": {"TALKER_RATE": "2"}})
    plan = shipped(facts(), robot=robot)
    composed = [step.argv for step in (*plan.steps, *plan.explain, *plan.recover) if "compose" in step.argv]
    assert len(composed) == 4
    assert all("TALKER_RATE" in argv[: argv.index("docker")] for argv in composed)


def test_a_stack_without_this_tests_changes_is_what_samples_say() -> None:
    """The tests above rest on it: one service, one image."""
    assert (NEW.services, NEW.images) == (tuple(STACK.images), (TALKER,))
