from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any
from unittest.mock import ANY

import pytest

from fleet.config import compose
from fleet.config.compose import HOME, Resolved
from fleet.errors import ComposeError

if TYPE_CHECKING:
    from collections.abc import Mapping

ONE = "services:\n  a:\n    image: x\n"


def write(folder: Path, files: Mapping[str, str]) -> None:
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


def resolved(
    folder: Path, environment: Mapping[str, str] | None = None, *, named: tuple[str, ...] = ("compose.yaml",)
) -> Resolved:
    with compose.opened([folder / name for name in named]) as project:
        return compose.resolve(project, environment=environment or {})


def services(folder: Path, text: str, files: Mapping[str, str] | None = None, **environment: str) -> Any:  # noqa: ANN401
    """The services of a stack whose compose.yaml is ``text``."""
    write(folder, {"compose.yaml": text, **(files or {})})
    return resolved(folder, environment).model["services"]


def refusal(folder: Path, text: str, files: Mapping[str, str] | None = None, **environment: str) -> str:
    """What is said of it; the folder is called ``P``."""
    with pytest.raises(ComposeError) as caught:
        services(folder, text, files, **environment)
    assert caught.value.exit_code == 2
    return str(caught.value).replace(str(folder), "P")


def test_the_file_beside_it_overrides(tmp_path: Path) -> None:
    """As ``docker compose up`` in that folder, with ``!reset`` and ``!override``."""
    over = {"compose.override.yaml": "services: {a: {ports: !reset [], command: !override [c], user: '7'}}"}
    found = services(tmp_path, ONE + "    ports: ['1:1']\n    command: [b]\n", over)
    assert (found["a"]["command"], found["a"]["user"]) == (["c"], "7")
    assert "ports" not in found["a"]


def test_several_files_that_the_inventory_names(tmp_path: Path) -> None:
    """Later ones win, the first one's folder counts, and no override is looked for."""
    write(tmp_path, {"compose.yaml": ONE, "sub/b.yaml": "services: {a: {command: [b], volumes: ['./m:/m']}}"})
    write(tmp_path, {"compose.override.yaml": "services: {a: {user: '7'}}"})
    found = resolved(tmp_path, named=("compose.yaml", "sub/b.yaml")).model["services"]["a"]
    assert found["command"] == ["b"]
    assert "user" not in found
    assert found["volumes"][0]["source"].endswith(f"/{tmp_path.name}/m")


def test_a_file_that_is_not_compose_yaml(tmp_path: Path) -> None:
    """It is taken though compose.yaml is there too."""
    write(tmp_path, {"compose.yaml": ONE, "robot.yaml": "services: {b: {image: y}}"})
    assert set(resolved(tmp_path, named=("robot.yaml",)).model["services"]) == {"b"}


def test_include_and_extends(tmp_path: Path) -> None:
    """Their relative paths are from where they stand."""
    files = {
        "sub/b.yaml": "services: {b: {image: y, env_file: e.env, volumes: ['./m:/m']}}",
        "sub/e.env": "Q=1\n",
    }
    text = "include: [sub/b.yaml]\nservices:\n  a: {image: x}\n  c: {extends: {file: sub/b.yaml, service: b}}\n  d: {extends: a}\n"
    found = services(tmp_path, text, files)
    assert (found["d"]["image"], found["c"]["image"]) == ("x", "y")
    assert found["b"]["environment"] == found["c"]["environment"] == {"Q": "1"}
    for name in "bc":
        assert found[name]["volumes"][0]["source"].endswith("/sub/m")


def test_what_lies_beside_the_folder_is_found(tmp_path: Path) -> None:
    """``extends`` and ``env_file`` may name a folder that several robots share."""
    shared = {"base.yaml": "services: {b: {image: y, volumes: ['./m:/m']}}", "e.env": "Q=1\n"}
    write(tmp_path / "shared", shared)
    text = "services: {a: {extends: {file: ../shared/base.yaml, service: b}, env_file: ../shared/e.env}}"
    found = services(tmp_path / "robot", text)["a"]
    assert (found["image"], found["environment"]) == ("y", {"Q": "1"})
    assert found["volumes"][0]["source"].endswith("/up/shared/m")


@pytest.mark.parametrize(
    ("files", "environment"),
    [
        ({"compose.yaml": ONE + "    env_file: ../shared/e.env\n"}, {}),
        ({"compose.yaml": ONE + "    env_file: $WHERE/e.env\n"}, {"WHERE": "../shared"}),
        ({"compose.yaml": ONE + "    env_file: $WHERE/e.env\n", ".env": "WHERE=../shared"}, {}),
        (
            {"compose.yaml": ONE, "compose.override.yaml": "services: {a: {env_file: ../shared/e.env}}"},
            {},
        ),
        (
            {"compose.yaml": "include: [more.yaml]\n", "more.yaml": ONE + "    env_file: ../shared/e.env\n"},
            {},
        ),
        ({"compose.yaml": "", ".env": "COMPOSE_FILE=../shared/all.yaml"}, {}),
        ({"compose.yaml": ""}, {"COMPOSE_FILE": "../shared/all.yaml"}),
    ],
    ids=str,
)
def test_whoever_names_what_lies_beside(
    files: Mapping[str, str], environment: Mapping[str, str], tmp_path: Path
) -> None:
    """The file, a variable of it, the override, an included file, and the list of files itself."""
    write(tmp_path / "shared", {"e.env": "Q=1\n", "all.yaml": ONE + "    env_file: ../shared/e.env\n"})
    write(tmp_path / "robot", files)
    found = resolved(tmp_path / "robot", environment).model["services"]["a"]
    assert found["environment"] == {"Q": "1"}


def test_a_second_file_beside_the_folder(tmp_path: Path) -> None:
    """A list in the inventory may name one of another folder."""
    write(tmp_path, {"robot/compose.yaml": ONE, "shared/more.yaml": "services: {a: {user: '7'}}"})
    found = resolved(tmp_path, named=("robot/compose.yaml", "shared/more.yaml"))
    assert found.model["services"]["a"]["user"] == "7"


def test_anchors_and_a_digest(tmp_path: Path) -> None:
    """A digest stays a digest."""
    image = f"x@sha256:{'0' * 64}"
    text = f"x-it: &it {{image: '{image}', user: '7'}}\nservices: {{a: *it, b: {{<<: *it, user: '8'}}}}"
    found = services(tmp_path, text)
    assert [found[name]["image"] for name in "ab"] == [image, image]
    assert [found[name]["user"] for name in "ab"] == ["7", "8"]


def test_where_values_come_from(tmp_path: Path) -> None:
    """The robot's before those of ``.env``, then a default; env_file and environment as Compose mixes them."""
    text = ONE + "    env_file: e.env\n    environment: [A, B, 'C=${C:-c}', D]\n"
    files = {".env": "A=1\nB=2\n", "e.env": "D=file\nE=$A\n"}
    found = services(tmp_path, text, files, B="robot", D="robot")
    assert found["a"]["environment"] == {"A": "1", "B": "robot", "C": "c", "D": "robot", "E": "1"}


def test_values_stay_as_they_are(tmp_path: Path) -> None:
    """Dollars, quotes, lines and letters of a robot's value are no syntax."""
    value = "a$b ${c} $$ \"q\" 'r' \\n\n\tü"
    found = services(tmp_path, ONE + "    environment: {A: '${A}', B: }\n", A=value, B=value)
    assert found["a"]["environment"] == {"A": value.replace("$", "$$"), "B": value.replace("$", "$$")}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("PATH", "/nowhere"),
        ("LD_PRELOAD", "/nowhere.so"),
        ("LD_LIBRARY_PATH", "/nowhere"),
        ("BASH_ENV", "/nowhere"),
        ("ENV", "/nowhere"),
        ("IFS", "/"),
        ("TMPDIR", "/nowhere"),
        ("DOCKER_HOST", "tcp://192.0.2.1:1"),
        ("DOCKER_CONTEXT", "nowhere"),
        ("DOCKER_CONFIG", "/nowhere"),
        ("DOCKER_API_VERSION", "0.1"),
        ("DOCKER_DEFAULT_PLATFORM", "linux/s390x"),
        ("COMPOSE_PATH_SEPARATOR", "x"),
        ("GODEBUG", "x"),
    ],
)
def test_names_that_mean_something_to_tools_are_values_of_the_stack(
    tmp_path: Path, name: str, value: str
) -> None:
    """`PATH` of a node is no PATH of Compose or Docker, here or on the robot: the stack has it, and nothing else differs."""
    text = f"{ONE}    environment: [{name}]\n    command: ['${{{name}}}']\n    volumes: ['./maps:/maps']\n"
    write(tmp_path, {"compose.yaml": text})
    usual, found = (resolved(tmp_path, {name: one}).model["services"] for one in ("usual", value))
    assert found["a"] == {**usual["a"], "environment": {name: value}, "command": [value], "volumes": ANY}
    (mount,) = found["a"]["volumes"]
    assert mount["target"] == "/maps"


def test_this_computers_environment_does_not_leak(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither into variables nor into what Compose reads; ``HOME`` is the robot's."""
    names = ("LEAK", "PATH", "DOCKER_CONFIG", "XDG_CACHE_HOME", "SSH_AUTH_SOCK", "USER")
    for name in names:
        monkeypatch.setenv(name, "leaked")
    for name in ("COMPOSE_FILE", "COMPOSE_PROFILES", "COMPOSE_PROJECT_NAME"):
        monkeypatch.setenv(name, "leaked")
    written = " ".join(f"${{{name}:-none}}" for name in names)
    text = f"{ONE}    environment: [HOME, {', '.join(names)}]\n    command: ['{written}']\n"
    found = services(tmp_path, text)
    assert found["a"]["command"] == [" ".join(["none"] * len(names))]
    assert found["a"]["environment"] == {"HOME": HOME, **dict.fromkeys(names)}


@pytest.mark.parametrize(
    ("environment", "files", "expected"),
    [
        ({}, {}, {"a"}),
        ({"COMPOSE_PROFILES": "viz"}, {}, {"a", "b"}),
        ({"COMPOSE_PROFILES": " dbg , viz,"}, {}, {"a", "b", "c"}),
        ({"COMPOSE_PROFILES": "*"}, {}, {"a", "b", "c"}),
        ({}, {".env": "COMPOSE_PROFILES=viz\n"}, {"a", "b"}),
        ({"COMPOSE_PROFILES": ""}, {".env": "COMPOSE_PROFILES=viz\n"}, {"a"}),
    ],
)
def test_profiles(
    tmp_path: Path, environment: dict[str, str], files: dict[str, str], expected: set[str]
) -> None:
    """Those of the robot, else those of ``.env``."""
    text = ONE + "  b: {image: y, profiles: [viz]}\n  c: {image: z, profiles: [dbg]}\n"
    assert set(services(tmp_path, text, files, **environment)) == expected


@pytest.mark.parametrize("files", [{}, {".env": "COMPOSE_PROFILES=nope\n"}])
def test_a_profile_that_no_service_has(tmp_path: Path, files: dict[str, str]) -> None:
    """Compose itself passes over it in silence."""
    environment = {} if files else {"COMPOSE_PROFILES": "nope,viz"}
    text = ONE + "  b: {image: y, profiles: [viz, dbg]}\n"
    said = refusal(tmp_path, text, files, **environment)
    assert said == "P/compose.yaml: no service has the profile nope; the file has: dbg, viz"


@pytest.mark.parametrize(
    ("folder", "text", "name"),
    [
        ("plain", ONE, "plain"),
        ("My Robot", ONE, "myrobot"),
        ("it's", ONE, "its"),
        ('say "hi"', ONE, "sayhi"),
        ("a$b", ONE, "ab"),
        ("${HOME}", ONE, "home"),
        ("räuber", ONE, "ruber"),
        ("100%", ONE, "100"),
        ("a\nb", ONE, "ab"),
        ("a:b#c\\d", ONE, "abcd"),
        ("-x", ONE, "x"),
        ("日本", "name: own\n" + ONE, "own"),
        ("plain", "name: ${N:-default}\n" + ONE, "default"),
    ],
)
def test_the_name_of_a_stack(tmp_path: Path, folder: str, text: str, name: str) -> None:
    """Compose's: of the file, else of its folder; paths below odd folders are still relative."""
    write(
        tmp_path / folder, {"compose.yaml": text + "    volumes: ['./maps:/maps', '../o:/o', '/abs:/abs']\n"}
    )
    with compose.opened([tmp_path / folder / "compose.yaml"]) as project:
        found = compose.resolve(project, environment={})
        sources = [volume["source"] for volume in found.model["services"]["a"]["volumes"]]
        relative = [project.relative(source) for source in sources]
        here = [project.here(source) for source in sources]
    assert (found.model["name"], found.warnings) == (name, ())
    assert [path and str(path) for path in relative] == ["maps", "../o", None]
    assert here == [tmp_path / folder / "maps", tmp_path / "o", Path("/abs")]


def test_paths_of_the_robots_home_and_far_above(tmp_path: Path) -> None:
    """``~`` is the robot's, ``${PWD}`` the project; a path far above is still known to be relative."""
    write(
        tmp_path,
        {"compose.yaml": ONE + "    volumes: ['~/maps:/a', '${PWD}/b:/b', '../../../../../../c:/c']\n"},
    )
    with compose.opened([tmp_path / "compose.yaml"]) as project:
        model = compose.resolve(project, environment={}).model
        sources = [volume["source"] for volume in model["services"]["a"]["volumes"]]
        assert sources[0] == f"{HOME}/maps"
        found = [project.relative(source) for source in sources]
    assert [path and str(path) for path in found] == [None, "b", "../../../../../../c"]


def test_a_folder_and_a_file_that_are_links(tmp_path: Path) -> None:
    """A folder counts by its real place; a linked file by the folder that it is linked into."""
    write(tmp_path, {"real/compose.yaml": ONE + "    volumes: ['./m:/m']\n"})
    (tmp_path / "alias").symlink_to("real")
    (tmp_path / "other").mkdir()
    (tmp_path / "other/compose.yaml").symlink_to("../real/compose.yaml")
    assert resolved(tmp_path / "alias").model["name"] == "real"
    assert resolved(tmp_path / "other").model["name"] == "other"


def test_nothing_is_left_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The links are removed, and what they lead to is not."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    services(tmp_path / "p", ONE)
    assert list((tmp_path / "temporary").iterdir()) == []
    assert (tmp_path / "p/compose.yaml").read_text() == ONE


def test_warnings(tmp_path: Path) -> None:
    """Each once, in Compose's words, without a path that nobody knows."""
    write(tmp_path, {"compose.yaml": "version: '3'\n" + ONE + "    command: ['${NO}', '${NO}']\n"})
    obsolete = "it will be ignored, please remove it to avoid potential confusion"
    assert sorted(resolved(tmp_path).warnings) == [
        'The "NO" variable is not set. Defaulting to a blank string.',
        f"compose.yaml: the attribute `version` is obsolete, {obsolete}",
    ]


REFERENCE = "see docs.docker.com/reference/compose-file"
MAKE = "make the file, or correct its name"
DEFINE = "define it in the file, or correct its name"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (ONE + "    imag: y\n", f"4: services.a.imag: there is no such key; {REFERENCE}"),
        (ONE + "foo: 1\n", f"4: 'foo': there is no such key; {REFERENCE}"),
        ("name: 1.0\n" + ONE, f"1: name must be a string; {REFERENCE}"),
        ("services:\n  a:\n    image: [x]\n", f"3: services.a.image must be a string; {REFERENCE}"),
        ("services:\n  a:\n", f"2: services.a must be a mapping; {REFERENCE}"),
        ("services:\n  a:\n    command: x\n", '2: service "a" has neither `image:` nor `build:`; name an image'),
        (
            ONE + "    environment:\n      A: ${NEED:?say it}\n",
            ("5: services.a.environment.A: the required variable NEED is not set (say it); "
            "set it under `environment:` of the robot in the inventory, or in the project's .env"),
        ),
        (
            "services:\n  a:\n    image: ${NEED?}\n",
            ("3: services.a.image: the required variable NEED is not set; "
            "set it under `environment:` of the robot in the inventory, or in the project's .env"),
        ),
        (ONE + "    command: ${A\n", "4: services.a.command: `${A` is not a variable; write `${NAME}`, or `$$` for a dollar sign"),
        (ONE + "    env_file: gone.env\n", f"4: the env_file `gone.env`: no such file; {MAKE}"),
        (ONE + "    extends:\n      file: ./gone.yaml\n      service: a\n", f"5: `gone.yaml`: no such file; {MAKE}"),
        ("include: [gone.yaml]\n" + ONE, f"1: `gone.yaml`: no such file; {MAKE}"),
        (ONE + "  b:\n    extends: c\n", f'5: cannot extend service "b" in compose.yaml: service "c" not found; {MAKE}'),
        (
            "services:\n  a: {extends: b}\n  b: {extends: a}\n",
            "2: services extend each other in a circle: a -> b -> a; remove one of them",
        ),
        (
            "services:\n  a: {image: x, depends_on: [b]}\n  b: {image: x, depends_on: [a]}\n",
            "2: services depend on each other in a circle: a -> b -> a; remove one of them",
        ),
        (ONE + "    depends_on:\n    - zz\n", f'5: service "a" depends on undefined service "zz"; {DEFINE}'),
        (ONE + "    volumes:\n    - data:/d\n", f'5: service "a" refers to undefined volume data; {DEFINE}'),
        (ONE + "    networks: [lan]\n", f'4: service "a" refers to undefined network lan; {DEFINE}'),
        (ONE + "    configs: [cc]\n", f'4: service "a" refers to undefined config cc; {DEFINE}'),
        (ONE + "    secrets: [cc]\n", f'4: service "a" refers to undefined secret cc; {DEFINE}'),
        (ONE + "    ports: ['99999:1']\n", "4: `99999` is not a port of the host; a port is a number from 1 to 65535"),
        (
            ONE + "    healthcheck: {test: [CMD, t], interval: 5parsecs}\n",
            ('4: services.a.healthcheck.interval: time: unknown unit "parsecs" in duration "5parsecs"; '
            "write a duration such as `1m30s`"),
        ),
        (
            ONE + "    network_mode: host\n    networks: [n]\nnetworks:\n  n:\n",
            "5: service a cannot have both `network_mode` and `networks`; remove one of them",
        ),
        ("services:\n  a: {image: x\n", "2: not YAML: the bracket that opens here is never closed, or a comma is missing in it"),
        ("services:\n\ta: x\n", "2: a tab in the indentation; YAML wants spaces"),
        ("services:\n  a: {image: x}\n  a: {image: y}\n", "3: the key 'a' is already on line 2; remove one of them"),
        ("- a\n", "1: holds a list; a mapping is needed here: lines like `key: value`"),
    ],
)  # fmt: skip
def test_a_refusal_has_its_line(tmp_path: Path, text: str, said: str) -> None:
    """One sentence with file and line, and a cure."""
    assert refusal(tmp_path, text) == f"P/compose.yaml:{said}"


@pytest.mark.parametrize(
    ("text", "files", "said"),
    [
        (ONE, {"compose.override.yaml": "services:\n  a:\n    imag: z\n"}, f"P/compose.override.yaml:3: services.a.imag: there is no such key; {REFERENCE}"),
        ("include: [sub/b.yaml]\n" + ONE, {"sub/b.yaml": "services:\n  b:\n    image: y\n    imag: z\n"}, f"P/sub/b.yaml:4: services.b.imag: there is no such key; {REFERENCE}"),
        ("include: [sub/b.yaml]\n" + ONE, {"sub/b.yaml": "services:\n  b: [\n"}, "P/sub/b.yaml:3: not YAML: the bracket that opens here is never closed, or a comma is missing in it"),
        (ONE, {".env": "OK=1\nA B C\n"}, "P/.env:2: key cannot contain a space; write `NAME=value`"),
        (ONE + "    env_file: e.env\n", {"e.env": "A B=1\n"}, "P/e.env:1: key cannot contain a space; write `NAME=value`"),
    ],
)  # fmt: skip
def test_a_refusal_names_the_file_that_is_to_blame(
    tmp_path: Path, text: str, files: dict[str, str], said: str
) -> None:
    """Overrides, included files and files of variables have lines of their own."""
    assert refusal(tmp_path, text, files) == said


def test_a_folder_whose_name_gives_no_name(tmp_path: Path) -> None:
    """The cure is `name:`."""
    said = refusal(tmp_path / "日本", ONE)
    what = "the stack has no name, and its folder's name has no usable letter"
    assert said == f"P/compose.yaml: {what}; write `name:` at the top of the file"


def test_a_repository_that_is_not_there(tmp_path: Path) -> None:
    """Git's words reach the person."""
    said = refusal(tmp_path, "include: ['https://127.0.0.1:1/x.git']\n" + ONE)
    assert said.startswith("P/compose.yaml:1: there is no repository at `https://127.0.0.1:1/x.git`: fatal: ")


def test_an_empty_and_a_missing_file(tmp_path: Path) -> None:
    """Said before Compose is asked, or in the same words."""
    assert refusal(tmp_path, "") == "P/compose.yaml is empty"
    with pytest.raises(ComposeError, match="no such file; `stack:` in the inventory names the Compose file"):
        resolved(tmp_path, named=("gone.yaml",))


USES = "services: {a: {image: x, secrets: [token], configs: [conf]}}\n"
GIVEN = "secrets:\n  token: {environment: TOKEN}\nconfigs:\n  conf: {environment: CONF}\n"


@pytest.mark.parametrize("file", ["compose.yaml", "robot.yaml"])
def test_secrets_and_configs_from_variables(tmp_path: Path, file: str) -> None:
    """Of the robot, or of the project's `.env`; as Compose reads them, byte for byte."""
    text = f"name: n\n{USES}{GIVEN}"
    write(tmp_path, {file: text, ".env": "TOKEN='a$b \"c\"'\nCONF=from-env\n"})
    model = resolved(tmp_path, {"CONF": "two\nlines ${x}"}, named=(file,)).model
    assert model["secrets"]["token"]["content"] == 'a$$b "c"'
    assert model["configs"]["conf"]["content"] == "two\nlines $${x}"
    assert resolved(tmp_path, {"CONF": ""}, named=(file,)).model["configs"]["conf"]["content"] == ""


def test_a_secret_whose_variable_is_not_set(tmp_path: Path) -> None:
    """A robot would start with an empty password. One that no service uses may stay unset."""
    cure = "set it under `environment:` of the robot in the inventory, or in the project's .env"
    what = "P/compose.yaml:3: secrets.token: the variable TOKEN is not set"
    assert refusal(tmp_path, USES + GIVEN, CONF="c") == f"{what}; {cure}"
    assert services(tmp_path, ONE + GIVEN)
