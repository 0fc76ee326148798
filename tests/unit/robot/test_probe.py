from __future__ import annotations

import contextlib
import json
import re
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet import onboard
from fleet.cli import json_output, status
from fleet.errors import NotAsPlanned, NotReady
from fleet.provision import daemon_json, steps
from fleet.robot.facts import Container, Dev, Disk, Docker, Facts, Fleet, Host, Login, Packages, StackFacts
from fleet.robot.probe import MARK, command, parse
from fleet.transfer import delivery
from tests.support.samples import PI


def answer(**sections: str) -> str:
    """A probe's answer with only these sections."""
    return "".join(f"\n{MARK} {name}\n{body}\n" for name, body in {**sections, "end": ""}.items())


def test_a_client_without_the_compose_plugin_has_no_compose() -> None:
    """Old clients answer an unknown command with their help, on standard output."""
    assert (
        parse(
            answer(docker="20.10.24", compose="Usage:  docker [OPTIONS] COMMAND\n\nA runtime")
        ).docker.compose
        == ""
    )
    assert parse(answer(docker="28.0.4", compose="v2.34.0")).docker.compose == "2.34.0"
    assert parse(answer(docker="28.0.4", compose="2.26.1-4")).docker.compose == "2.26.1-4"


def test_the_whole_answer_of_a_pi() -> None:
    """Every section ends in the fact of its name."""
    said = answer(
        machine="aarch64",
        userland="arm64",
        os="Debian GNU/Linux 13 (trixie)",
        login="pi\n/home/pi\npi sudo docker",
        sudo="password",
        clock="1790000000",
        memory="948304",
        disk="Filesystem 1024-blocks Used Available Capacity Mounted on\n/dev/root 30000000 20000000 10000000 67% /",
        temperature="54321",
        emulates="/proc/sys/fs/binfmt_misc/qemu-arm",
        boot="enabled",
        finish="enabled\n0a1b",
        **{"boot unit": "enabled\n0b2c"},
        daemon='{\n  "log-driver": "json-file"\n}',
        packages="docker-ce\ndocker-buildx",
        interrupted="Status: install ok half-configured",
        source="/etc/apt/sources.list.d/docker.list",
        group="docker:x:996:pi,tim",
        identity="0123abcd\n11-22",
        stacks="stack nav\ncurrent releases/abc\nchecksum 0a1b\nservice node=always\nservice map=no\nboot systemd\nstopped\nrelease abc\nrelease def\nrelease ghi.part\ndata 12\njournal ship abc\ndev 2026-11-28T12:00:00Z tim@desktop\nevent one\ttwo\nevent three\nstack cam\ncurrent \ndata unknown",
        legacy="old",
        docker="28.0.4",
        client="Docker version 28.0.4, build b8034c0",
        store="/var/lib/docker overlay2 extfs true",
        compose="2.34.0",
        images="talker:fleet-1 sha256:aa\nb:fleet-2 sha256:bb",
    )
    assert parse(said) == Facts(
        host=Host(
            identity="0123abcd 11-22",
            machine="aarch64",
            userland="arm64",
            os="Debian GNU/Linux 13 (trixie)",
            clock=1790000000.0,
            temperature=54.321,
            memory=971_063_296,
            emulates=("qemu-arm",),
        ),
        login=Login(name="pi", home="/home/pi", groups=("pi", "sudo", "docker"), sudo="password"),
        disk=Disk(size=30_720_000_000, free=10_240_000_000),
        docker=Docker(
            state="ready",
            kind="docker",
            version="28.0.4",
            client="28.0.4",
            compose="2.34.0",
            driver="overlay2",
            members=("pi", "tim"),
            daemon_config='{\n  "log-driver": "json-file"\n}',
            starts_at_boot=True,
            finish_unit="0a1b",
            boot_unit="0b2c",
        ),
        packages=Packages(installed=("docker-ce", "docker-buildx"), interrupted=True, docker_source=True),
        fleet=Fleet(
            stacks={
                "nav": StackFacts(
                    current="abc",
                    checksum="0a1b",
                    releases=("abc", "def"),
                    services=("node", "map"),
                    history=("one\ttwo", "three"),
                    data=12 * 1024,
                    journal="ship abc",
                    boot="systemd",
                    stopped=True,
                    dev=Dev(by="tim@desktop", since="2026-11-28T12:00:00Z"),
                ),
                "cam": StackFacts(data=None),
            },
            legacy="old",
            images={"talker:fleet-1": "sha256:aa", "b:fleet-2": "sha256:bb"},
        ),
    )


def test_what_a_login_script_prints_is_noise_and_not_an_answer() -> None:
    """It would corrupt streams, so it is kept to be complained about; no fact comes from it."""
    seen = parse("Welcome to pi1!\nroot\n" + answer(machine="aarch64", login="pi\n/home/pi\npi"))
    assert seen.login.noise == "Welcome to pi1!\nroot"
    assert (seen.host.machine, seen.login.name) == ("aarch64", "pi")


def test_sections_that_are_missing_leave_the_defaults() -> None:
    """An old or odd robot answers less; nothing is made up."""
    assert parse(answer()) == Facts()
    assert parse("") == Facts()


SECTIONS = re.findall(r"^ *section '?([\w ]+)'?$", onboard.text("probe.sh"), flags=re.MULTILINE)


@given(st.dictionaries(st.sampled_from(SECTIONS), st.text()))
def test_garbage_in_any_section_is_no_traceback(sections: dict[str, str]) -> None:
    """A robot may print anything; what cannot be read is a fact that is not there."""
    parse(answer(**sections))


LINE = {
    "name": "/nav-node-1",
    "state": "running",
    "code": 0,
    "restarts": 2,
    "health": "healthy",
    "policy": "unless-stopped",
    "started": "2026-09-21T14:13:20.123456789Z",
    "ended": "0001-01-01T00:00:00Z",
    "service": "node",
    "release": "abc",
    "stack": "nav",
    "robot": "pi1",
}
NODE = Container(
    name="nav-node-1",
    service="node",
    release="abc",
    stack="nav",
    robot="pi1",
    state="running",
    health="healthy",
    restarts=2,
    policy="unless-stopped",
    since=1_790_000_000.0,
)


LIES = (
    "9" * 400,
    "9" * 5000,
    "-" + "9" * 400,
    "²",
    "٣",
    "1e999",
    "NaN",
    "[" * 200_000,
    "null",
    "[]",
    "{}",
    "\0",
    "\u202e\x9b",
)


@pytest.mark.parametrize("lie", LIES, ids=[f"{lie[:2]!a} x {len(lie)}" for lie in LIES])
def test_a_lie_is_no_traceback_whoever_reads_it(lie: str) -> None:
    """In each section, in each column of `df`, in each value of JSON: what is made of it for people and programs too."""
    for name in SECTIONS:
        read_by_all(parse(answer(**{"docker": "28.0.4", name: lie})))
    for columns in (f"{lie} 1 1 1 1 /", f"/dev/x {lie} 1 {lie} 1 /"):
        read_by_all(parse(answer(disk=f"heading\n{columns}", **{"home disk": columns})))
    for key, value in LINE.items():
        for said in (lie, json.dumps(lie)):
            line = json.dumps(LINE).replace(f'"{key}": {json.dumps(value)}', f'"{key}": {said}')
            read_by_all(parse(answer(docker="28.0.4", containers=line)))


def read_by_all(facts: Facts) -> None:
    """Make all that is made of facts without asking the robot more."""
    json_output.text(status.record(facts)).encode()
    status.good(facts)
    for row in status.rows("pi1", facts):
        "".join(text for text, _ in row).encode()
    status.events(facts)
    delivery.encoding(facts)
    pinned = PI.model_copy(update={"docker": PI.docker.model_copy(update={"version": "27.5.1"})})
    with contextlib.suppress(NotReady):
        steps.plan(robot=pinned, facts=facts, script=b"#", now=1.0, by="tim@desk")
    with contextlib.suppress(NotReady):
        daemon_json.steps(PI, facts)


@given(st.text())
def test_any_answer_is_no_traceback(said: str) -> None:
    """The end of the answer may be in a banner, before the first section, or twice."""
    read_by_all(parse(said))
    read_by_all(parse(f"\n{MARK} {said}\n{MARK} end\n"))


@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
        lambda inner: (
            st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(sorted(LINE)), inner, max_size=12)
        ),
    )
)
def test_any_json_is_a_container_or_none(value: object) -> None:
    """Docker prints `null` for labels that are not there, and a liar anything."""
    read_by_all(parse(answer(docker="28.0.4", containers=json.dumps(value))))


@pytest.mark.parametrize(
    ("name", "line", "count", "what"),
    [
        ("stacks", "stack {}", 201, "201 stacks"),
        ("containers", '{{"name": "c", "stack": "{}"}}', 201, "201 stacks"),
        ("containers", "{{}}", 2002, "lines about containers"),
        ("images", "image {}", 60_000, "lines"),
    ],
)
def test_more_than_any_robot_has_is_refused(name: str, line: str, count: int, what: str) -> None:
    """A megabyte of short lines would be a gigabyte of facts."""
    lines = "\n".join(line.format(number) for number in range(count))
    with pytest.raises(NotAsPlanned, match=f"the robot's answer has .*{what}, which cannot be"):
        parse(answer(docker="28.0.4", **{name: lines}))


@pytest.mark.parametrize(
    ("said", "members"), [("", None), ("docker:x:996:", ()), ("docker:x:996:pi", ("pi",))]
)
def test_no_docker_group_is_another_thing_than_an_empty_one(
    said: str, members: tuple[str, ...] | None
) -> None:
    """Without Docker's package there is no group to put the login into."""
    assert parse(answer(group=said)).docker.members == members


@pytest.mark.parametrize(
    ("values", "seen"),
    [
        ({}, NODE),
        (
            {"state": "exited", "code": 7, "health": "", "ended": "2026-09-21T14:13:30Z"},
            replace(NODE, state="exited", code=7, health="", since=1_790_000_010.0),
        ),
        ({"started": "0001-01-01T00:00:00Z"}, replace(NODE, since=-62135596800.0)),
        ({"started": "soon"}, replace(NODE, since=0.0)),
        ({"robot": None, "restarts": "many"}, replace(NODE, robot="", restarts=0)),
    ],
)
def test_containers_say_how_they_are(values: dict[str, object], seen: Container) -> None:
    """From lines of JSON; Docker's warnings may stand between. Their stack is there, also without its folder."""
    said = f"WARNING: no swap limit\n{json.dumps({**LINE, **values})}\n[]\n{{}}"
    assert parse(answer(docker="28.0.4", containers=said)).fleet.stacks == {
        "nav": StackFacts(containers=(seen,))
    }


def test_each_stack_has_its_own_containers() -> None:
    """Two stacks on one robot may have services and releases of the same name."""
    lines = "\n".join(json.dumps({**LINE, "stack": stack}) for stack in ("nav", "cam", "nav"))
    stacks = parse(answer(stacks="stack cam\ncurrent releases/abc", containers=lines)).fleet.stacks
    assert [(name, len(stack.containers)) for name, stack in stacks.items()] == [("cam", 1), ("nav", 2)]


@pytest.mark.parametrize(
    ("said", "memory"),
    [("948304", 971_063_296), ("-1", 0), ("948304 kB", 0), ("1\n2", 0), ("9" * 5000, 0)],
)
def test_its_memory(said: str, memory: int) -> None:
    """Said in KiB, kept in bytes; 0 is unknown."""
    assert parse(answer(memory=said)).host.memory == memory


def test_images_are_asked_for_with_a_word() -> None:
    """Without it the probe is the quick one."""
    assert command()[4:] == ()
    assert command(images=True)[4:] == ("images",)


def test_the_identity_of_an_image_is_its_configurations_digest() -> None:
    """Its ID in a classic store; in a containerd store what its receipt names, if that is the manifest of this ID."""
    sent = "nav:fleet-2 sha256:m1 sha256:c1 m1"
    other = "cam:fleet-3 sha256:m2 sha256:c2 m9"
    seen = parse(answer(images=f"talker:fleet-1 sha256:c0\n{sent}\n{other}\nnonsense"))
    assert seen.fleet.images == {
        "talker:fleet-1": "sha256:c0",
        "nav:fleet-2": "sha256:c1",
        "cam:fleet-3": "sha256:m2",
    }


@pytest.mark.parametrize(
    ("said", "root", "store", "containerd"),
    [
        ("/var/lib/docker overlay2 extfs true", "/var/lib/docker", "overlay2", False),
        ("/ssd/docker overlay2", "/ssd/docker", "overlay2", False),
        ("/var/lib/docker overlayfs io.containerd.snapshotter.v1", "/var/lib/docker", "overlayfs", True),
        ("", "/var/lib/docker", "", False),
        (" overlay2 x", "/var/lib/docker", "", False),
    ],
)
def test_where_and_how_docker_keeps_images(said: str, root: str, store: str, containerd: bool) -> None:
    """On Jetsons the data are often on another disk; which store it is decides what may be left out."""
    seen = parse(f"\n{MARK} store\n{said}\n{MARK} end\n")
    assert (seen.docker.data_root, seen.docker.driver, seen.docker.containerd) == (root, store, containerd)
