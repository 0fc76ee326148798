from __future__ import annotations

import functools
import json
import re
import tempfile
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleet.config import yamlfile
from fleet.config.inventory import Docker, Inventory, Robot, StackFiles, json_schema, load
from fleet.config.ros import Ros
from fleet.errors import InventoryError, SelectionError
from tests.support.inventory_files import inventory, write

PROJECT = Path(__file__).parents[3]
REGENERATE = "python -c 'import json, fleet.config.inventory as i; print(json.dumps(i.json_schema(), indent=2))' > inventory.schema.json"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """People run `fab` where the inventory is; messages name files from there."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_all_defaults(folder: Path) -> None:
    """A robot that says nothing is called by its name and leaves the login to OpenSSH."""
    fleet = inventory("robots: {pi1: }")
    assert fleet == Inventory(
        path=Path("inventory.yaml"),
        known_hosts=folder / "known_hosts",
        robots={
            "pi1": Robot(
                name="pi1",
                address="pi1",
                stacks=(StackFiles(files=(folder / "docker/compose.yaml",)),),
                known_hosts=folder / "known_hosts",
            )
        },
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
stack: {files: [stacks/my.yaml, stacks/more.yaml], outside: [shared], settle: 0, wait: 900}
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
    pass_environment: [TOKEN, DISPLAY]
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
        pass_environment=("TOKEN", "DISPLAY"),
        files={"cam.yaml": folder / "config/cam.yaml", "a/b c": folder / "config/cam.yaml"},
        stacks=(
            StackFiles(
                files=(folder / "stacks/my.yaml", folder / "stacks/more.yaml"),
                outside=(folder / "shared",),
                settle=0,
                wait=900,
            ),
        ),
        known_hosts=folder / "keys/hosts",
    )


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
        InventoryError, match=r"^inventory\.yaml: no such file; go to the folder that has it, or write one"
    ):
        load(Path("inventory.yaml"))
    Path("inventory.yaml").mkdir()
    with pytest.raises(InventoryError, match=r"^inventory\.yaml is a directory"):
        load(Path("inventory.yaml"))


def test_stacks_of_groups_and_robots(folder: Path) -> None:
    """The nearest `stack:` counts whole; a file alone, a list and the long form mean what they say."""
    robots = inventory("""
stack: [a.yaml, {files: [b.yaml], settle: 3}]
groups: {two: {robots: [pi2, pi3], stack: two.yaml}}
robots: {pi1: , pi2: , pi3: {stack: {files: [x/y.yaml, z.yaml]}}, pi4: {stack: }}
""").robots
    both = (StackFiles(files=(folder / "a.yaml",)), StackFiles(files=(folder / "b.yaml",), settle=3))
    assert [robot.stacks for robot in robots.values()] == [
        both,
        (StackFiles(files=(folder / "two.yaml",)),),
        (StackFiles(files=(folder / "x/y.yaml", folder / "z.yaml")),),
        both,
    ]


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
words = st.sampled_from(
    ["robots", "groups", "defaults", "include", "path", "ros", "ip", "docker", "script", "files", "environment",
     "stack", "known_hosts", "identity_file", "port", "pi1", "all", "*", "inventory.yaml", "~x", "/", ".."]
)  # fmt: skip
nested = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | words,
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
    assert inventory(example(everything=False)).robots == {}
    write("defaults: {user: root}\nrobots: {lab-pi1: 127.0.0.1}", ".lab/inventory.yaml")
    fleet = inventory(example(everything=False))
    assert [robot.name for robot in fleet.select("fleet")] == ["lab-pi1"]
    assert fleet.robots["lab-pi1"].user == "root"


def test_example_in_full() -> None:
    """Every commented-out line of the example is valid."""
    for name in ("config/camera.yaml", "certs/ca.crt", "certs/client.crt", "certs/client.key"):
        write("", name)
    fleet = inventory(example(everything=True))
    assert list(fleet.robots) == ["pi1", "pi2", "pi3", "pi4"]
    assert fleet.groups["lidar"] == ("pi1", "pi2")
    assert fleet.robots["pi2"].environment == {"TALKER_RATE": "1", "LIDAR": "/dev/ttyUSB0"}
    assert fleet.robots["pi3"].environment == {"TALKER_RATE": "0.5"}
    assert [len(robot.stacks) for robot in fleet.robots.values()] == [2, 2, 1, 1]
    assert fleet.robots["pi4"].ros.version == 2
    assert fleet.robots["pi4"].peers == ("pi1.local", "192.168.1.22", "pi3.local")


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


@functools.cache
def validator() -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(json_schema())


def valid(source: str) -> bool:
    return validator().is_valid(yamlfile.read(write(source), error=InventoryError).value)


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
ros: {version: 1} | ros: {version: 2} | ros: {version: 3} | ros: {version: true} | ros: {version: '2'} | ros: {version: 1.5}
ros: {version: 2, domain: 0} | ros: {version: 2, domain: 101} | ros: {version: 2, domain: 102} | ros: {version: 2, domain: 214}
ros: {version: 2, domain: 215} | ros: {version: 2, domain: 233} | ros: {version: 2, domain: -1} | ros: {version: 2, domain: '7'}
ros: {version: 2, domain: } | ros: {version: 2, rmw: rmw_zenoh_cpp} | ros: {version: 2, rmw: rmw_zeno_cpp} | ros: {version: 2, rmw: 1}
ros: {version: 2, discovery: subnet} | ros: {version: 2, discovery: 'off'} | ros: {version: 2, discovery: off} | ros: {version: 2, discovery: SUBNET}
ros: {version: 2, peers: [all]} | ros: {version: 2, peers: }  | ros: {version: 2, peers: [1]} | ros: {version: 2, peers: all} | ros: {version: 2, peers: ['a b']}
ros: {version: 2, master: own} | ros: {version: 2, hostname: a} | ros: {version: 2, hostname: } | ros: {version: 2, ip: 10.0.0.1}
ros: {version: 1, domain: 1} | ros: {version: 1, peers: [all]} | ros: {version: 1, rmw: rmw_zenoh_cpp} | ros: {version: 1, discovery: subnet}
environment: {ROS_DOMAIN_ID: 7} | environment: {RMW_IMPLEMENTATION: x} | environment: {ROS_DOMAIN_IDS: 7}
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
STACKS = (
    "x", "", "1", "''", "[]", "[x, y]", "[x, {files: [y]}]", "[1]", "[x, '']", "{files: [x]}", "{files: x}", "{files: []}",
    "{files: ['']}", "{settle: 1}", "{}", "{files: [x], settle: 0}", "{files: [x], settle: -1}", "{files: [x], settle: 3601}",
    "{files: [x], wait: 0}", "{files: [x], wait: 1}", "{files: [x], wait: '1'}", "{files: [x], outside: [..]}",
    "{files: [x], outside: ..}", "{files: [x], outside: }", "{files: [x], x: 1}",
)  # fmt: skip
FILES = [
    *(f"{part}: {{{name}stack: {value}{end}}}" for value in STACKS for part, name, end in (("defaults", "", ""), ("robots", "a: {", "}"))),
    *(f"defaults: {{pass_environment: {value}}}" for value in ("[A]", "[]", "A", "[1]", "[a-b]", "[FLEET_X]", "")),
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
    "include: [{path: x, required: 0}]", "defaults:", "defaults: []", *(f"stack: {value}" for value in STACKS), "known_hosts: x", "x: 1",
]  # fmt: skip


@pytest.mark.parametrize("source", FILES)
def test_schema_agrees(source: str) -> None:
    """An editor marks exactly what `fab` refuses."""
    assert valid(source) == accepted(source)


def test_schema_disagreement_would_show() -> None:
    """The table holds both kinds: what is accepted, and what is refused."""
    answers = [accepted(source) for source in FILES]
    assert min(answers.count(True), answers.count(False)) > 50
