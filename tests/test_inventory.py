from __future__ import annotations

import json
import re
import tempfile
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet import yamlfile
from fleet.errors import InventoryError, SelectionError
from fleet.inventory import Docker, Inventory, Robot, Ros, json_schema, load

PROJECT = Path(__file__).parent.parent
REGENERATE = "python -c 'import json, fleet.inventory as i; print(json.dumps(i.json_schema(), indent=2))' > inventory.schema.json"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """People run `fab` where the inventory is; messages name files from there."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(source: str, name: str = "inventory.yaml") -> Path:
    path = Path(name)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(source, encoding="utf-8")
    return path


def inventory(source: str) -> Inventory:
    return load(write(source))


def problems(source: str) -> list[str]:
    with pytest.raises(InventoryError) as raised:
        inventory(source)
    first, *rest = str(raised.value).replace(f"{Path.cwd()}/", "").split("\n  ")
    assert (first == f"inventory.yaml has {len(rest)} problems:") == bool(rest)
    return rest or [first]


def test_all_defaults(folder: Path) -> None:
    """A robot that says nothing is called by its name and leaves the login to OpenSSH."""
    fleet = inventory("robots: {pi1: }")
    assert fleet == Inventory(
        path=Path("inventory.yaml"),
        stack=folder / "docker/compose.yaml",
        known_hosts=folder / "known_hosts",
        robots={"pi1": Robot(name="pi1", address="pi1", known_hosts=folder / "known_hosts")},
        groups={"all": ("pi1",)},
    )
    assert fleet.robots["pi1"].ros == Ros(master="own")
    assert fleet.robots["pi1"].docker == Docker(
        script="https://get.docker.com", log_max_size="10m", log_max_file=3
    )
    assert fleet.robots["pi1"].platform == "linux/arm64"


def test_everything_said(folder: Path) -> None:
    """Every value of a robot arrives, with paths from the inventory's folder."""
    write("", "config/cam.yaml")
    write("", "install.sh")
    robot = inventory(
        r"""
stack: stacks/my.yaml
known_hosts: keys/hosts
robots:
  pi1:
    address: fe80::1%eth0
    user: ubuntu
    port: 2222
    identity_file: keys/id
    platform: linux/arm/v7
    ros: {master: "http://desktop:11311", ip: 192.168.1.4, namespace: /a/b}
    docker: {script: install.sh, sha256: "ABAB",  version: 27.5.1, log_max_size: 5m, log_max_file: 1}
    environment: {A: a b, B: 1.50, C: 042, D: '', E: "$(x)\nü'\"", F: 2024-01-01, g_1: 'yes'}
    files: {cam.yaml: config/cam.yaml, a/b c: config/cam.yaml}
""".replace("ABAB", "aB" * 32)
    ).robots["pi1"]
    assert robot == Robot(
        name="pi1",
        address="fe80::1%eth0",
        user="ubuntu",
        port=2222,
        identity_file=folder / "keys/id",
        platform="linux/arm/v7",
        ros=Ros(master="http://desktop:11311", ip="192.168.1.4", namespace="/a/b"),
        docker=Docker(
            script=str(folder / "install.sh"),
            sha256="aB" * 32,
            version="27.5.1",
            log_max_size="5m",
            log_max_file=1,
        ),
        environment={
            "A": "a b",
            "B": "1.50",
            "C": "042",
            "D": "",
            "E": "$(x)\nü'\"",
            "F": "2024-01-01",
            "g_1": "yes",
        },
        files={"cam.yaml": folder / "config/cam.yaml", "a/b c": folder / "config/cam.yaml"},
        known_hosts=folder / "keys/hosts",
    )


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
    assert fleet.stack == folder / "mine.yaml"
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


@pytest.mark.parametrize(
    ("source", "sentence"),
    [
        ("robts: {}", "robts: no such key; did you mean 'robots'?"),
        ("xyz: {}", "xyz: no such key; there are: stack, known_hosts, include, defaults, groups, robots"),
        ("robots: {pi3: {platfrom: x}}", "robots.pi3.platfrom: no such key; did you mean 'platform'?"),
        ("robots: {pi3: {ros: {mster: own}}}", "robots.pi3.ros.mster: no such key; did you mean 'master'?"),
        ("robots: {ros: {prot: 1}}", "robots.ros.prot: no such key; did you mean 'port'?"),
        ("defaults: {docker: {sha: x}}", "defaults.docker.sha: no such key; did you mean 'sha256'?"),
        ("groups: {g: {robot: [x]}}", "groups.g.robot: no such key; did you mean 'robots'?"),
        (
            "defaults: {addres: x}",
            "defaults.addres: no such key; there are: user, port, identity_file, platform, ros, docker, environment, files",
        ),
        ("robots: [pi1]", "robots: must hold `key: value` lines"),
        ("robots: {pi1: [x]}", "robots.pi1: must hold `key: value` lines"),
        ("groups: {g: x}", "groups.g: must hold `key: value` lines"),
        ("include: x", "include: must be a list"),
        ("stack:", "stack: must be text, not nothing"),
        ("stack: ' '", "stack: must not be empty"),
        ("robots: {pi1: {port: 0}}", "robots.pi1.port: must be a whole number from 1 to 65535, not 0"),
        (
            "robots: {pi1: {port: 65536}}",
            "robots.pi1.port: must be a whole number from 1 to 65535, not 65536",
        ),
        ("robots: {pi1: {port: '22'}}", "robots.pi1.port: must be a whole number from 1 to 65535, not 22"),
        ("robots: {pi1: {port: 2.5}}", "robots.pi1.port: must be a whole number from 1 to 65535, not 2.5"),
        ("robots: {pi1: {port: yes}}", "robots.pi1.port: must be a whole number from 1 to 65535, not true"),
        ("robots: {port: [1]}", "robots.port: must hold `key: value` lines"),
        ("robots: {pi1: {user: 1000}}", "robots.pi1.user: must be text, not 1000; put it in quotes"),
        ("robots: {pi1: {user: [a]}}", "robots.pi1.user: must be text, not a list"),
        ("robots: {pi1: {user: {}}}", "robots.pi1.user: must be text, not a mapping"),
        ("robots: {pi1: {user: a b}}", "robots.pi1.user: must be a login name, without '@', ':' or spaces"),
        (
            "robots: {pi1: {address: %s}}" % ("9" * 60),
            "robots.pi1.address: must be text, not " + "9" * 37 + "...; put it in quotes",
        ),
        *(
            (
                f"robots: {{pi1: {{address: '{address}'}}}}",
                (
                    "robots.pi1.address: must be a host name or an IP address alone; the login goes under `user`, "
                    "the port under `port`"
                ),
            )
            for address in ("", "-oProxyCommand=x", "a b", "pi@pi1", "pi1:22", "http://pi1", "[::1]", "a,b")
        ),
        (
            "robots: {pi1: pi@pi1}",
            "robots.pi1.address: must be a host name or an IP address alone; the login goes under `user`, the port under `port`",
        ),
        (
            "robots: {a/b: }",
            "robots['a/b']: is no name: letters, digits, '_', '.' and '-', a letter or digit first",
        ),
        (
            "robots: {pi*: }",
            "robots['pi*']: is no name: letters, digits, '_', '.' and '-', a letter or digit first",
        ),
        (
            "robots: {'a,b': }",
            "robots['a,b']: is no name: letters, digits, '_', '.' and '-', a letter or digit first",
        ),
        (
            "groups: {-g: []}",
            "groups.-g: is no name: letters, digits, '_', '.' and '-', a letter or digit first",
        ),
        (
            "groups: {all: []}",
            "groups.all: 'all' always means every robot; values for every robot go under `defaults`",
        ),
        (
            "robots: {all: }",
            "robots.all: 'all' always means every robot; values for every robot go under `defaults`",
        ),
        ("robots: {pi1: }\ngroups: {g: [p1]}", "groups.g[0]: no such robot: p1; did you mean 'pi1'?"),
        (
            "robots: {pi1: }\ngroups: {g: {robots: [pi1, all]}}",
            "groups.g.robots[1]: no such robot: all; a group holds robots, not groups",
        ),
        ("groups: {g: [zz]}", "groups.g[0]: no such robot: zz"),
        ("groups: {g: ['a b']}", "groups.g[0]: must be a robot's name or a wildcard such as 'pi*'"),
        ("groups: {g: [1]}", "groups.g[0]: must be text, not 1; put it in quotes"),
        (
            "robots: {a: }\ngroups: {a: []}",
            "groups.a: a robot has this name (inventory.yaml:1); rename one of them",
        ),
        (
            "defaults: {platform: aarch64}",
            "defaults.platform: must be one of linux/arm64, linux/arm/v7, linux/amd64; did you mean 'linux/arm64'?",
        ),
        (
            "defaults: {platform: linux/arm7}",
            "defaults.platform: must be one of linux/arm64, linux/arm/v7, linux/amd64; did you mean 'linux/arm/v7'?",
        ),
        (
            "defaults: {platform: 5}",
            "defaults.platform: must be one of linux/arm64, linux/arm/v7, linux/amd64",
        ),
        ("defaults: {ros: {ip: 10.0.0.300}}", "defaults.ros.ip: must be an IP address such as 192.168.1.21"),
        ("defaults: {ros: {ip: pi1}}", "defaults.ros.ip: must be an IP address such as 192.168.1.21"),
        (
            "defaults: {ros: {hostname: a_b., ip: 10.0.0.1}}",
            "defaults.ros.hostname: must be a host name such as pi1.local; an IP address without a name goes under `ip`",
        ),
        (
            "defaults: {ros: {hostname: a, ip: 10.0.0.1}}",
            "defaults.ros: hostname and ip exclude each other; remove one of them",
        ),
        (
            "defaults: {ros: {namespace: 1a}}",
            "defaults.ros.namespace: must be a ROS name such as 'pi1' or '/site/pi1': letters, digits and '_'",
        ),
        *(
            (
                f"defaults: {{ros: {{master: '{master}'}}}}",
                "defaults.ros.master: must be 'own' or a URI such as http://desktop.local:11311",
            )
            for master in ("mine", "http://desktop", "http://desktop:99999", "https://a:1", "http://a b:1")
        ),
        (
            "defaults: {docker: {version: 27.5}}",
            "defaults.docker.version: must be text, not 27.5; put it in quotes",
        ),
        (
            "defaults: {docker: {version: '27.5'}}",
            "defaults.docker.version: must be a full version such as '27.5.1': a shorter one would match several",
        ),
        (
            "defaults: {docker: {sha256: abc}}",
            "defaults.docker.sha256: must be 64 hexadecimal digits, as `sha256sum` prints them",
        ),
        (
            "defaults: {docker: {log_max_size: 10MB}}",
            "defaults.docker.log_max_size: must be a number and k, m or g, such as '10m'",
        ),
        (
            "defaults: {docker: {log_max_file: 0}}",
            "defaults.docker.log_max_file: must be a whole number, 1 or more, not 0",
        ),
        ("defaults: {docker: {script: x.sh}}", "defaults.docker.script: no such file: x.sh"),
        (
            "defaults: {environment: {A: yes}}",
            "defaults.environment.A: YAML reads yes, no, on, off, true and false as a truth value; quote it",
        ),
        ("defaults: {environment: {A: }}", "defaults.environment.A: has no value; write '' for an empty one"),
        ("defaults: {environment: {A: [1]}}", "defaults.environment.A: must be text or a number"),
        (
            "defaults: {environment: {A-B: 1}}",
            "defaults.environment.A-B: is no name for a variable: letters, digits and '_', not a digit first",
        ),
        (
            "defaults: {environment: {ROS_MASTER_URI: x}}",
            "defaults.environment.ROS_MASTER_URI: fleet sets this variable itself; set it as `ros: {master: ...}`",
        ),
        (
            "defaults: {environment: {ROS_HOSTNAME: x}}",
            "defaults.environment.ROS_HOSTNAME: fleet sets this variable itself; set it as `ros: {hostname: ...}`; without it the robot's address is used",
        ),
        (
            "defaults: {environment: {ROS_IP: x}}",
            "defaults.environment.ROS_IP: fleet sets this variable itself; set it as `ros: {ip: ...}`",
        ),
        (
            "defaults: {environment: {ROS_NAMESPACE: x}}",
            "defaults.environment.ROS_NAMESPACE: fleet sets this variable itself; set it as `ros: {namespace: ...}`",
        ),
        (
            "defaults: {environment: {COMPOSE_PROJECT_NAME: x}}",
            "defaults.environment.COMPOSE_PROJECT_NAME: fleet sets this variable itself; set it as `name:` in the stack's Compose file",
        ),
        (
            "defaults: {environment: {FLEET_X: x}}",
            "defaults.environment.FLEET_X: names that begin with FLEET_ are fleet's own; choose another",
        ),
        *(
            (
                f"defaults: {{files: {{'{name}': inventory.yaml}}}}",
                (
                    f"defaults.files['{name}']: must be a plain relative path: it stays below files/ on the robot "
                    "(no '/' first or last, no '.' or '..')"
                ),
            )
            for name in ("/a", "../a", "a/../b", "a/..", ".", "./a", "a//b", "a/", "")
        ),
        ("defaults: {files: {a: no/file}}", "defaults.files.a: no such file: no/file"),
        ("defaults: {files: {a: .}}", "defaults.files.a: . is a folder; name its files one by one"),
        ("defaults: {files: {a: %s}}" % ("x" * 300), "defaults.files.a: no such file: " + "x" * 300),
        (
            "robots: {pi1: {files: {a: inventory.yaml, a/b: inventory.yaml}}}",
            "robots.pi1.files: 'a' cannot be a file and also the folder of 'a/b'",
        ),
    ],
)
def test_problem(source: str, sentence: str) -> None:
    """Each mistake is one sentence: file, line, key, what is wrong, the cure."""
    found = [problem.replace(f": {Path.cwd()} is", ": . is") for problem in problems(source)]
    assert [re.sub(r"^inventory\.yaml:\d+: ", "", problem) for problem in found] == [sentence]


def test_all_problems_at_once() -> None:
    """One run lists everything, in the order of lines, whatever kind it is."""
    assert problems("""robots:
  pi1:
    platfrom: linux/arm64
    port: 70000
  pi2: {files: {a: nope}}
  pi1: again
  broken: [1]
groups:
  lidar:
    - pi1
    - pi22
    - broken
defaults:
  environment:
    DEBUG: on
""") == [
        "inventory.yaml:3: robots.pi1.platfrom: no such key; did you mean 'platform'?",
        "inventory.yaml:4: robots.pi1.port: must be a whole number from 1 to 65535, not 70000",
        "inventory.yaml:5: robots.pi2.files.a: no such file: nope",
        "inventory.yaml:6: the key 'pi1' is already on line 2; remove one of them",
        "inventory.yaml:7: robots.broken: must hold `key: value` lines",
        "inventory.yaml:11: groups.lidar[1]: no such robot: pi22; did you mean 'pi2'?",
        (
            "inventory.yaml:15: defaults.environment.DEBUG: YAML reads yes, no, on, off, true and false as a truth "
            "value; quote it"
        ),
    ]


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"", "inventory.yaml is empty"),
        (b"- pi1", "inventory.yaml:1: holds a list; a mapping is needed here: lines like `key: value`"),
        (b"robots:\n\tpi1: x", "inventory.yaml:2: a tab in the indentation; YAML wants spaces"),
        (b"\xff\xfe", "inventory.yaml is not UTF-8 text (byte 0); save it as UTF-8"),
    ],
)
def test_no_inventory(content: bytes, sentence: str) -> None:
    """A file that is no mapping is refused in one sentence."""
    Path("inventory.yaml").write_bytes(content)
    with pytest.raises(InventoryError) as raised:
        load(Path("inventory.yaml"))
    assert str(raised.value) == sentence


def test_no_file() -> None:
    """A missing inventory and a folder of its name are refused in one sentence."""
    with pytest.raises(
        InventoryError, match=r"^inventory\.yaml: no such file; run `fab` in the folder that has"
    ):
        load(Path("inventory.yaml"))
    Path("inventory.yaml").mkdir()
    with pytest.raises(InventoryError, match=r"^inventory\.yaml is a directory"):
        load(Path("inventory.yaml"))


def test_select() -> None:
    """Selection gives robots in file order, and says what is wrong with a name."""
    fleet = inventory("robots: {pi1: , pi2: , nano: }\ngroups: {lidar: [nano, pi1]}")
    assert [robot.name for robot in fleet.select("lidar")] == ["pi1", "nano"]
    assert [robot.name for robot in fleet.select("nano,pi?")] == ["pi1", "pi2", "nano"]
    assert fleet.select("all") == tuple(fleet.robots.values())
    with pytest.raises(SelectionError, match="--hosts lidr: no such robot or group; did you mean 'lidar'"):
        fleet.select("lidr")


def test_select_without_robots() -> None:
    """An inventory without robots says how to get some, whatever is asked for."""
    fleet = inventory("groups: {fleet: ['*']}\nrobots:")
    for hosts in ("all", "fleet", "pi1"):
        with pytest.raises(SelectionError) as raised:
            fleet.select(hosts)
        assert raised.value.what == "inventory.yaml names no robots"
        assert raised.value.cure == "`fab lab.up` starts three virtual Pis, or add yours under `robots:`"


def test_robots_are_keys() -> None:
    """A robot can be looked up in a dictionary, equal robots are one key."""
    assert {Robot(name="a", address="b"): 1}[Robot(name="a", address="b", environment={})] == 1


yamlish = st.text(st.sampled_from("ab:- \n[]{},&*!<'\"|>?#%@\t01~./"), max_size=60)
scalars = st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5))
words = st.sampled_from(
    ["robots", "groups", "defaults", "include", "path", "ros", "ip", "docker", "script", "files", "environment",
     "stack", "known_hosts", "identity_file", "port", "pi1", "all", "*", "inventory.yaml", "~x", "/", ".."]
)  # fmt: skip
nested = st.recursive(
    scalars | words,
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(words | st.text(max_size=3), inner, max_size=4)
    ),
    max_leaves=20,
)
shaped = st.dictionaries(
    st.sampled_from(["stack", "known_hosts", "include", "defaults", "groups", "robots"]),
    nested | st.dictionaries(words, nested, max_size=3) | st.lists(nested, max_size=3),
)


@given(st.one_of(st.text(), yamlish, shaped.map(json.dumps)))
def test_anything(source: str) -> None:
    """Whatever the file holds, the answer is an inventory or an InventoryError."""
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "inventory.yaml"
        path.write_bytes(source.encode("utf-8", "surrogatepass"))
        try:
            assert isinstance(load(path), Inventory)
        except InventoryError as bad:
            said = str(bad)
            assert said.startswith(name)


def example(*, everything: bool) -> str:
    """The example inventory; ``everything`` takes the `#` off its examples, which have no space after it."""
    source = (PROJECT / "inventory.yaml").read_text(encoding="utf-8")
    return re.sub(r"^( *)#(?=[^\s#])", r"\1", source, flags=re.MULTILINE) if everything else source


def test_example_as_cloned() -> None:
    """The example as it comes includes the lab where there is one, and is sound without."""
    fleet = inventory(example(everything=False))
    assert fleet.robots == {}
    assert fleet.stack == Path.cwd() / "docker/compose.yaml"
    write("defaults: {user: root}\nrobots: {lab-pi1: 127.0.0.1}", ".lab/inventory.yaml")
    fleet = inventory(example(everything=False))
    assert [robot.name for robot in fleet.select("fleet")] == ["lab-pi1"]
    assert fleet.robots["lab-pi1"].user == "root"


def test_example_in_full() -> None:
    """Every commented-out line of the example is valid."""
    write("", "config/camera.yaml")
    fleet = inventory(example(everything=True))
    assert list(fleet.robots) == ["pi1", "pi2", "pi3"]
    assert fleet.groups["lidar"] == ("pi1", "pi2")
    assert fleet.robots["pi2"].environment == {"TALKER_RATE": "1", "LIDAR": "/dev/ttyUSB0"}
    assert fleet.robots["pi3"].environment == {"TALKER_RATE": "0.5"}


def keys(value: object) -> set[str]:
    if isinstance(value, dict):
        return set(value).union(*(keys(inner) for inner in value.values()))
    return set().union(*(keys(inner) for inner in value)) if isinstance(value, list) else set()


def test_example_shows_every_key() -> None:
    """There is no key that the example does not show."""
    schema = json_schema()
    definitions: list[dict[str, Any]] = [schema, *schema["$defs"].values()]
    known = {key for definition in definitions for key in definition["properties"]}
    shown = keys(yamlfile.read(write(example(everything=True)), error=InventoryError).value)
    assert len(known) > 20
    assert known - shown == set()


def test_schema_is_checked_in() -> None:
    """inventory.schema.json is what the models say today."""
    checked_in = json.loads((PROJECT / "inventory.schema.json").read_text(encoding="utf-8"))
    assert checked_in == json_schema(), f"run: {REGENERATE}"


def test_schema_explains_every_key() -> None:
    """Editors have a sentence for every key."""
    schema = json_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    definitions: dict[str, dict[str, Any]] = {"top": schema, **schema["$defs"]}
    silent = [
        f"{name}.{key}"
        for name, definition in definitions.items()
        for key, value in definition["properties"].items()
        if not value.get("description")
    ]
    assert silent == []


def valid(schema: dict[str, Any], source: str) -> bool:
    value = yamlfile.read(write(source), error=InventoryError).value
    return jsonschema.Draft202012Validator(schema).is_valid(value)


def accepted(source: str) -> bool:
    try:
        inventory(source)
    except InventoryError:
        return False
    return True


VALUES = (
    r"""
user: pi | user: | user: 1 | user: a b | user: -x | port: 22 | port: | port: 0 | port: 65536 | port: '22' | port: true
platform: linux/arm64 | platform: linux/arm | platform: | identity_file: x | identity_file: | identity_file: ''
ros: | ros: {} | ros: x | ros: {master: own} | ros: {master: } | ros: {master: x} | ros: {master: 'http://a:1'}
ros: {master: 'http://a:70000'} | ros: {master: 'http://[::1]:5/'} | ros: {hostname: a} | ros: {hostname: } | ros: {ip: 10.0.0.1}
ros: {ip: '::1'} | ros: {ip: x} | ros: {hostname: a, ip: 10.0.0.1} | ros: {hostname: a, ip: } | ros: {namespace: a/b}
ros: {namespace: 1} | ros: {namespace: 'a b'} | ros: {x: 1} | docker: {version: 27.5.1} | docker: {version: 27.5} | docker: {version: 27}
docker: {log_max_size: 10m} | docker: {log_max_size: 10} | docker: {log_max_file: 1} | docker: {log_max_file: 0} | docker: {log_max_file: true}
docker: {script: 'https://x'} | docker: {script: ''} | docker: {sha256: x} | docker: {x: 1} | docker:
environment: {A: x} | environment: {A: 1} | environment: {A: 1.5} | environment: {A: true} | environment: {A: } | environment: {A: []}
environment: {1A: x} | environment: {a-b: x} | environment: {FLEET_A: x} | environment: {ROS_IP: x} | environment: {ROS_IPS: x} | environment:
environment: {"A\n": x} | files: {a: inventory.yaml} | files: {a/b.c: inventory.yaml} | files: {../a: inventory.yaml} | files: {/a: inventory.yaml}
files: {a/../b: inventory.yaml} | files: {a/.b: inventory.yaml} | files: {..a: inventory.yaml} | files: {a/: inventory.yaml} | files: {'': inventory.yaml}
files: {a: 1} | files: | x: 1 | address: a
""".strip()
    .replace("\n", " | ")
    .split(" | ")
)
FILES = [
    *(f"defaults: {{{value}}}" for value in VALUES),
    *(f"robots: {{pi1: {{{value}}}}}" for value in VALUES),
    *(f"groups: {{g: {{{value}}}}}" for value in VALUES),
    *(f"robots: {{pi1: {{address: '{address}'}}}}" for address in ("a.b", "10.0.0.1", "fe80::1%eth0", "a:1", "a@b", "-a", "a b", "")),
    *(f"robots: {{'{name}': }}" for name in ("a", "A.b-c_9", "all", "all2", "-a", "a,b", "a*", "a b", "")),
    *(f"groups: {{'{name}': []}}" for name in ("a", "all", "a b")),
    "robots: {pi1: pi1.local}", "robots: {pi1: 1}", "robots: {pi1: []}", "robots: []", "robots:", "robots: {pi1: a@b}",
    "groups:", "groups: {g: ['*']}", "groups: {g: [1]}", "groups: {g: x}", "groups: {g: }", "groups: {g: {robots: }}",
    "groups: {g: {robots: ['a b']}}", "groups: {g: {robots: ['a*'], port: 1}}", "groups: {g: {robots: a}}",
    "include: [{path: x, required: false}]", "include: [{required: false}]", "include: [x]", "include: {}", "include:",
    "include: [{path: x, required: 0}]", "defaults:", "defaults: []", "stack: x", "stack:", "stack: 1", "known_hosts: x", "x: 1",
]  # fmt: skip


@pytest.mark.parametrize("source", FILES)
def test_schema_agrees(source: str) -> None:
    """An editor marks exactly what `fab` refuses."""
    assert valid(json_schema(), source) == accepted(source)


def test_schema_disagreement_would_show() -> None:
    """The table holds both kinds: what is accepted, and what is refused."""
    answers = [accepted(source) for source in FILES]
    assert min(answers.count(True), answers.count(False)) > 50
