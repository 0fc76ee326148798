from __future__ import annotations

import json
import tempfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.config.inventory import Docker, load
from fleet.config.ros import Ros
from tests.support.inventory_files import inventory, problems, write


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """People run `fab` where the inventory is; messages name files from there."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_merge_order() -> None:
    """Defaults, then groups in file order, then the robot; mappings key by key; null takes a value back."""
    robot = inventory(
        """
robots:
  pi1: {environment: {D: robot}, user: null, ros: {namespace: pi1}}
groups:
  one: {robots: [pi1], port: 1, environment: {B: one, C: one, D: one}, docker: {log_max_file: 1}}
  two: {robots: ["pi*"], port: 2, environment: {C: two, D: two}}
  other: {robots: [pi2], port: 9, environment: {A: other}}
defaults:
  user: pi
  platform: linux/amd64
  environment: {A: defaults, B: defaults, C: defaults, D: defaults}
  docker: {log_max_file: 9, log_max_size: 1k}
  ros: {master: "http://m:1", namespace: x}
""".replace("pi1: {env", "pi2:\n  pi1: {env")
    ).robots["pi1"]
    assert robot.environment == {"A": "defaults", "B": "one", "C": "two", "D": "robot"}
    assert (robot.user, robot.port, robot.platform) == (None, 2, "linux/amd64")
    assert robot.docker == Docker(log_max_size="1k", log_max_file=1)
    assert robot.ros == Ros(master="http://m:1", namespace="pi1")


def test_hostname_and_ip_replace_each_other() -> None:
    """The nearest of hostname and ip wins; never do both arrive."""
    robots = inventory("""
defaults: {ros: {hostname: all.local, namespace: n}, environment: {ip: x}}
robots:
  pi1: {ros: {ip: 10.0.0.1}, environment: {hostname: y}}
  pi2: {ros: {hostname: pi2.local}}
  pi3: {ros: {hostname: null}}
""").robots
    assert robots["pi1"].ros == Ros(ip="10.0.0.1", namespace="n")
    assert robots["pi1"].environment == {"ip": "x", "hostname": "y"}
    assert robots["pi2"].ros == Ros(hostname="pi2.local", namespace="n")
    assert robots["pi3"].ros == Ros(namespace="n")


def test_a_ros_version_replaces_the_keys_of_the_other_one() -> None:
    """A fleet may have robots of both: one that says its version inherits no key that it does not know."""
    robots = inventory("""
defaults: {ros: {master: "http://m:1", namespace: n}}
groups: {two: {robots: [pi2, pi3], ros: {version: 2, domain: 7}}}
robots: {pi1: , pi2: {ros: {domain: null}}, pi3: {ros: {version: 1, ip: 10.0.0.3}}}
""").robots
    assert robots["pi1"].ros == Ros(master="http://m:1", namespace="n")
    assert robots["pi2"].ros == Ros(version=2, namespace="n")
    assert robots["pi3"].ros == Ros(version=1, ip="10.0.0.3", namespace="n")


def test_peers_are_the_addresses_of_other_robots() -> None:
    """Robots, groups and wildcards, also of included files; each address once, never the robot's own."""
    write("robots: {lab1: 10.1.0.1, lab2: 10.1.0.2}\ngroups: {arms: [lab1]}", "lab.yaml")
    robots = inventory("""
include: [{path: lab.yaml}]
defaults: {ros: {version: 2, peers: [arms, "pi*", lab1]}}
groups: {arms: [pi3], none: []}
robots: {pi1: 10.0.0.1, nano: {ros: {peers: [none]}}, pi3: pi3.local, pi4: {ros: {peers: [all]}}}
""").robots
    assert robots["pi1"].peers == ("10.1.0.1", "pi3.local", "pi4")
    assert robots["nano"].peers == ()
    assert robots["pi4"].peers == ("10.1.0.1", "10.1.0.2", "10.0.0.1", "nano", "pi3.local")
    assert robots["lab1"].peers == ()


def test_peers_of_a_broken_included_file_are_not_blamed() -> None:
    """Its robots cannot be known."""
    write("robots: [", "lab.yaml")
    source = "include: [{path: lab.yaml}]\nrobots: {pi1: {ros: {version: 2, peers: [lab1]}}}"
    assert [problem.partition(":")[0] for problem in problems(source)] == ["lab.yaml"]


LAYERS = st.dictionaries(st.sampled_from("ABCD"), st.sampled_from(["1", "2", "x y", ""]), max_size=4)


@given(defaults=LAYERS, groups=st.lists(st.tuples(st.booleans(), LAYERS), max_size=4), own=LAYERS)
def test_merge_is_the_last_word(
    defaults: dict[str, str], groups: list[tuple[bool, dict[str, str]]], own: dict[str, str]
) -> None:
    """A robot's environment is what stacking dictionaries in the stated order gives."""
    said = {
        "robots": {"pi1": {"environment": own}},
        "groups": {
            f"g{n}": {"robots": ["pi1"] if inside else [], "environment": values}
            for n, (inside, values) in enumerate(groups)
        },
        "defaults": {"environment": defaults},
    }
    expected = dict(defaults)
    for inside, values in groups:
        expected |= values if inside else {}
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "inventory.yaml"
        path.write_text(json.dumps(said))
        assert load(path).robots["pi1"].environment == expected | own


def test_short_forms() -> None:
    """A robot may be its address, a group its list, and a commented-out mapping nothing."""
    fleet = inventory("""
defaults:
groups: {a: [pi1, "nan?"], b: , c: {robots: }}
include:
robots: {pi1: pi1.local, nano: {ros: , docker: , environment: , files: }, pi3: }
""")
    assert [robot.address for robot in fleet.robots.values()] == ["pi1.local", "nano", "pi3"]
    assert fleet.groups == {"a": ("pi1", "nano"), "b": (), "c": (), "all": ("pi1", "nano", "pi3")}


def test_home(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    """``~`` is the person's home; an unknown person's stays as written."""
    monkeypatch.setenv("HOME", "/home/me")
    robots = inventory("robots: {a: {identity_file: ~/.ssh/id}, b: {identity_file: ~nobody.here/id}}").robots
    assert robots["a"].identity_file == Path("/home/me/.ssh/id")
    assert robots["b"].identity_file == folder / "~nobody.here/id"


def test_yaml_merges_and_aliases() -> None:
    """YAML's own means of reuse work, numbers in them stay as written."""
    robots = inventory("""
defaults: {environment: &e {A: 1.50}}
robots: {pi1: {environment: {<<: *e, B: 2}}, pi2: &r {port: 22}, pi3: *r}
""").robots
    assert robots["pi1"].environment == {"A": "1.50", "B": "2"}
    assert robots["pi3"].port == 22


LAB = """
known_hosts: hosts
defaults: {user: labuser, identity_file: key, environment: {A: lab, B: lab, C: lab, D: lab}}
groups: {virtual: {robots: ["*"], environment: {B: virtual, C: virtual, D: virtual}}, both: [lab1]}
robots: {lab1: {environment: {D: own}}, lab2: }
"""


def test_include(folder: Path) -> None:
    """Included robots keep their file's values; the including file's groups, not its defaults, reach them."""
    write(LAB, ".lab/inventory.yaml")
    fleet = inventory("""
include: [{path: .lab/inventory.yaml}]
stack: mine.yaml
defaults: {user: pi, port: 7, environment: {A: mine}}
groups:
  fleet: {robots: ["*"], environment: {C: fleet, D: fleet}}
  both: {robots: [pi1], port: 99}
robots: {pi1: }
""")
    assert list(fleet.robots) == ["lab1", "lab2", "pi1"]
    assert fleet.robots["lab1"].environment == {"A": "lab", "B": "virtual", "C": "fleet", "D": "own"}
    assert fleet.robots["lab1"].identity_file == folder / ".lab/key"
    assert fleet.robots["lab1"].known_hosts == folder / ".lab/hosts"
    assert [robot.user for robot in fleet.robots.values()] == ["labuser", "labuser", "pi"]
    assert [robot.port for robot in fleet.robots.values()] == [99, None, 99]
    assert fleet.robots["pi1"].known_hosts == fleet.known_hosts == folder / "known_hosts"
    stacks = {name: robot.stacks[0].files for name, robot in fleet.robots.items()}
    assert stacks["pi1"] == (folder / "mine.yaml",)
    assert stacks["lab1"] == stacks["pi1"]
    assert fleet.groups == {
        "virtual": ("lab1", "lab2"),
        "both": ("lab1", "pi1"),
        "fleet": ("lab1", "lab2", "pi1"),
        "all": ("lab1", "lab2", "pi1"),
    }


def test_include_of_an_include() -> None:
    """Includes nest; each file's paths are its own."""
    write("robots: {deep: {identity_file: k}}\nknown_hosts: h", "a/b/deep.yaml")
    write("include: [{path: b/deep.yaml}]\nrobots: {mid: }", "a/mid.yaml")
    fleet = inventory("include: [{path: a/mid.yaml}]\nrobots: {top: }")
    assert list(fleet.robots) == ["deep", "mid", "top"]
    assert fleet.robots["deep"].identity_file == Path.cwd() / "a/b/k"


def test_include_missing() -> None:
    """A file that need not exist is no robots; without `required: false` it is a problem at its line."""
    assert inventory("include: [{path: no.yaml, required: false}]").robots == {}
    assert problems("include:\n  - {path: no.yaml}") == [
        "inventory.yaml:2: include[0].path: no such file: no.yaml; if it may be missing, say `required: false`"
    ]


def test_include_required_is_a_truth_value() -> None:
    """`required` is true or false, nothing that resembles it."""
    write("robots:", "there.yaml")
    assert problems("include: [{path: there.yaml, required: 1}]") == [
        "inventory.yaml:1: include[0].required: must be true or false"
    ]


def test_include_problems() -> None:
    """An included file's problems are listed with its own name and lines, after the including file's."""
    write("robots:\n  pi1: {usr: x}\n  pi2:\ngroups: {pi3: [pi2]}", "other/inv.yaml")
    write("a: [", "broken.yaml")
    assert problems("""include:
  - path: other/inv.yaml
  - path: inventory.yaml
  - pth: x
  - path: broken.yaml
  - path: nothing.yaml
groups:
  pi2: ["*"]
  maybe: [could-be-in-broken]
robots:
  pi1:
  pi3:
""") == [
        "inventory.yaml:3: include[1].path: a file cannot include itself, not by way of another either",
        "inventory.yaml:4: include[2].path: is missing",
        "inventory.yaml:4: include[2].pth: no such key; did you mean 'path'?",
        "inventory.yaml:6: include[4].path: no such file: nothing.yaml; if it may be missing, say `required: false`",
        "inventory.yaml:8: groups.pi2: a robot has this name (other/inv.yaml:3); rename one of them",
        "inventory.yaml:11: robots.pi1: this robot is in other/inv.yaml:2 already; rename one of them",
        "inventory.yaml:12: robots.pi3: an included file has a group of this name; rename one of them",
        "other/inv.yaml:2: robots.pi1.usr: no such key; did you mean 'user'?",
        "broken.yaml:1: not YAML: the bracket that opens here is never closed, or a comma is missing in it",
    ]


def test_include_twins() -> None:
    """Two included files with a robot of one name: both places are named."""
    write("robots: {pi1: }", "a.yaml")
    write("robots:\n  pi1:", "b.yaml")
    assert problems("include:\n- path: a.yaml\n- path: b.yaml") == [
        "inventory.yaml:3: include[1].path: robots.pi1 of b.yaml:2 is in a.yaml:1 already; rename one of them"
    ]
