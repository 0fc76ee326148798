from __future__ import annotations

import io
import json
import subprocess
import tarfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from fleet.config import compose as desktop
from fleet.config.compose import HOME, LEVELS, Project, Resolved
from fleet.config.project_files import File, ProjectFiles
from fleet.config.stack import read
from fleet.images.image import Image
from fleet.robot import release as releases
from fleet.robot.release import Release, compose
from tests.support import samples
from tests.support.robot_shell import EACH_SHELL

if TYPE_CHECKING:
    from collections.abc import Mapping

ABOVE = Path("/tmp/t").joinpath(*["up"] * LEVELS)
HERE = f"{ABOVE}/robot"
PROJECT = Project(files=(Path("robot/compose.yaml"),), real=Path("/home/tim/robot"), folder=ABOVE / "robot")
IMAGE = Image(reference="x:latest", platform="linux/arm64", size=1, identity=f"sha256:{'aa' * 32}")
FILES = ProjectFiles()


def release(
    service: Mapping[str, Any] | None = None,
    *,
    files: ProjectFiles = FILES,
    image: Image = IMAGE,
    robot: str = "pi1",
    **model: Any,  # noqa: ANN401
) -> Release:
    whole = {"name": "robot", "services": {"node": {"image": "x", **(service or {})}}, **model}
    stack = read(Resolved(model=whole), PROJECT)
    images = dict.fromkeys(stack.services, image)
    return compose(robot=robot, stack=stack, project=PROJECT, files=files, images=images)


def written(made: Release, home: str = "/home/pi") -> Any:  # noqa: ANN401
    """The Compose file as the robot gets it."""
    return json.loads(made.files(home)["compose.yaml"].data)


def node(made: Release) -> Any:  # noqa: ANN401
    return written(made)["services"]["node"]


def test_a_service_is_pinned_and_labelled() -> None:
    """To the image, its platform and the release; labels of its own stay."""
    made = release({"platform": "linux/amd64", "labels": {"own": "1"}, "command": None, "entrypoint": None})
    assert node(made) == {
        "image": IMAGE.shipped_as,
        "platform": "linux/arm64",
        "labels": {
            "own": "1",
            "fleet.release": made.id,
            "fleet.stack": "robot",
            "fleet.robot": "pi1",
        },
    }
    assert (made.stack, made.robot, made.images) == ("robot", "pi1", (IMAGE,))


def test_what_only_the_desktop_needs_is_left_out() -> None:
    """How an image is built, and what other tools read."""
    more = {
        "build": {"context": HERE},
        "develop": {"watch": []},
        "profiles": ["p"],
        "pull_policy": "always",
        "x-a": 1,
    }
    unknown: dict[str, Any] = {"x-b": 2}
    made = release(more, networks={}, **unknown)  # fmt: skip
    assert set(node(made)) == {"image", "platform", "labels"}
    assert set(written(made)) == {"name", "services"}


def test_paths() -> None:
    """Data lies beside the releases, files in them; the home is the login's, and an absolute path stays."""
    sources = ("maps", "nav.yaml", "../out/a", "a$$b")
    volumes = [{"type": "bind", "source": f"{HERE}/{name}", "target": "/t"} for name in sources]
    volumes[2]["source"] = f"{ABOVE}/out/a"
    volumes += [{"type": "bind", "source": one, "target": "/t"} for one in ("/dev/x", f"{HOME}/bags")]
    volumes.append({"type": "volume", "source": "v", "target": "/t"})
    made = release({"volumes": volumes}, files=ProjectFiles(data=frozenset({"maps"})), volumes={"v": {"driver_opts": {"device": f"{HERE}/maps"}}})  # fmt: skip
    whole = written(made)
    stack = "/home/pi/.fleet/stacks/robot"
    project = f"{stack}/releases/{made.id}/project"
    assert [one["source"] for one in whole["services"]["node"]["volumes"]] == [
        f"{stack}/data/maps",
        f"{project}/nav.yaml",
        f"{project}/_up/out/a",
        f"{project}/a$$b",
        "/dev/x",
        "/home/pi/bags",
        "v",
    ]
    assert whole["volumes"]["v"]["driver_opts"]["device"] == f"{stack}/data/maps"
    assert (
        written(made, home='/srv/$a "b"\\')["services"]["node"]["volumes"][5]["source"]
        == '/srv/$$a "b"\\/bags'
    )


def test_no_path_of_this_computer_is_left() -> None:
    """``${PWD}`` in a command or a variable is the project's place on the robot, the same in each run."""
    made = release({"environment": {"PWD": HERE}, "command": ["ls", f"{HERE}/maps"]})
    assert str(ABOVE) not in made.compose
    project = f"/home/pi/.fleet/stacks/robot/releases/{made.id}/project"
    assert node(made)["environment"] == {"PWD": project}
    assert node(made)["command"] == ["ls", f"{project}/maps"]


def test_words_for_old_versions_of_compose() -> None:
    """What the canonical model says in words of today is said as Compose 2.5 reads it."""
    made = release(
        {
            "depends_on": {"b": {"condition": "service_started", "required": True}},
            "devices": [{"source": "/dev/a", "target": "/dev/b", "permissions": "r"}, {"source": "/dev/c"}],
            "extra_hosts": ["pi=10.0.0.1"],
            "gpus": [{"count": -1}],
            "volumes": [{"type": "bind", "source": "/a", "target": "/b"}],
        }
    )
    found = node(made)
    assert found["depends_on"] == {"b": {"condition": "service_started"}}
    assert found["devices"] == ["/dev/a:/dev/b:r", "/dev/c:/dev/c:rwm"]
    assert found["extra_hosts"] == ["pi:10.0.0.1"]
    assert found["deploy"]["resources"]["reservations"]["devices"] == [{"capabilities": ["gpu"], "count": -1}]
    assert found["volumes"][0]["bind"] == {"create_host_path": True}


def test_devices_of_cdi_and_paths_with_colons() -> None:
    """Old versions take a CDI name for a path, and text has no place for a colon in one."""
    by_path = {"source": "/dev/serial/by-path/pci-0000:01:00.0-usb", "target": "/dev/a", "permissions": "rwm"}
    gpu = {"source": "nvidia.com/gpu=all", "target": "nvidia.com/gpu=all", "permissions": "rwm"}
    found = node(release({"devices": [gpu, by_path], "gpus": [{"count": 1}]}))
    assert found["devices"] == [by_path]
    assert found["deploy"]["resources"]["reservations"]["devices"] == [
        {"capabilities": ["gpu"], "count": 1},
        {"driver": "cdi", "capabilities": ["cdi"], "device_ids": ["nvidia.com/gpu=all"]},
    ]
    assert "devices" not in node(release({"devices": [gpu]}))


def test_configs_and_secrets_become_files() -> None:
    """Text and variables too, which old versions of Compose do not know."""
    configs = {
        "a": {"content": "x$$y"},
        "b": {"file": f"{HERE}/b.conf"},
        "c": {"environment": "C", "content": "c"},
    }
    secrets = {
        "s": {"environment": "TOKEN", "content": "t$$", "name": "robot_s"},
        "out": {"external": True},
    }
    made = release(configs=configs, secrets=secrets)
    project = f"/home/pi/.fleet/stacks/robot/releases/{made.id}/project"
    whole = written(made)
    assert {name: one["file"] for name, one in whole["configs"].items()} == {
        "a": f"{project}/configs/a",
        "b": f"{project}/b.conf",
        "c": f"{project}/configs/c",
    }
    assert whole["secrets"] == {
        "s": {"file": f"{project}/secrets/s", "name": "robot_s"},
        "out": {"external": True},
    }
    assert made.project == {
        "configs/a": File(data=b"x$y"),
        "configs/c": File(data=b"c"),
        "secrets/s": File(data=b"t$"),
    }
    assert "t$" not in made.compose


def test_a_variable_without_a_value_stays_unset() -> None:
    """The login's own shell on the robot must not give one."""
    assert node(release({"environment": {"A": None, "B": ""}}))["environment"] == {"B": ""}


def test_the_environment_of_a_stack_is_in_its_compose_file_alone() -> None:
    """No file of the release is one that a shell or Docker on the robot reads by itself, such as `.env`."""
    names = ("PATH", "LD_PRELOAD", "DOCKER_HOST", "COMPOSE_FILE", "BASH_ENV", "IFS")
    environment = dict.fromkeys(names, "only-the-stack's")
    made = release({"environment": environment})
    assert node(made)["environment"] == environment
    files = made.files("/home/pi")
    assert [name for name, file in files.items() if b"only-the-stack's" in file.data] == ["compose.yaml"]
    assert set(files) == {"compose.yaml", "services", "data-folders"}


def test_each_ingredient_changes_the_id() -> None:
    """Model, image, files, seeds, folders, a secret's value: none may change unseen."""
    other = replace(IMAGE, identity="linux/arm64\nlayer sha256:bb")
    made = [
        release(),
        release({"user": "7"}),
        release(image=other),
        release(files=ProjectFiles(files={"a": File(data=b"1")})),
        release(files=ProjectFiles(files={"a": File(data=b"1", mode=0o755)})),
        release(files=ProjectFiles(files={"a": File(link="1")})),
        release(files=ProjectFiles(seeds={"a": File(data=b"1")})),
        release(files=ProjectFiles(folders=("a",))),
        *(release(secrets={"s": {"environment": "T", "content": value}}) for value in "12"),
    ]
    assert len({one.id for one in made}) == len(made)
    assert all(len(one.id) == 12 for one in made)


def test_where_it_is_made_does_not_change_the_id() -> None:
    """The project's folder here, the image's size and order are no content."""
    model = {"image": "x", "volumes": [{"type": "bind", "source": f"{HERE}/a", "target": "/a"}]}
    elsewhere = Path("/var/q").joinpath(*["up"] * LEVELS) / "robot"
    moved = json.loads(json.dumps(model).replace(HERE, str(elsewhere)))
    ids = []
    for folder, service in ((PROJECT.folder, model), (elsewhere, moved)):
        project = replace(PROJECT, folder=folder)
        stack = read(Resolved(model={"services": {"node": service}, "name": "robot"}), project)
        ids.append(compose(robot="pi1", stack=stack, project=project, files=FILES, images={"node": IMAGE}).id)
    assert ids[0] == ids[1]


PROJECT_FILES = ProjectFiles(
    files={"run": File(data=b"#!", mode=0o755), "d/link": File(link="../run"), "a b/'q' $x": File(data=b"\0\xff")},
    seeds={"ü/nav.yaml": File(data=b"a")},
    folders=("maps",),
)  # fmt: skip


def unpacked(made: Release, folder: Path) -> None:
    with tarfile.open(fileobj=io.BytesIO(made.archive("/home/pi"))) as archive:
        archive.extractall(folder, filter="tar")


def test_the_archive_unpacks_as_it_was(tmp_path: Path) -> None:
    """Bytes, modes and links; only the login reads the Compose file; the same bytes every time."""
    made = release(files=PROJECT_FILES)
    unpacked(made, tmp_path)
    assert (tmp_path / "compose.yaml").stat().st_mode & 0o777 == 0o600
    assert (tmp_path / "project/run").stat().st_mode & 0o777 == 0o755
    assert (tmp_path / "project/d/link").readlink() == Path("../run")
    assert (tmp_path / "project/a b/'q' $x").read_bytes() == b"\0\xff"
    assert (tmp_path / "seeds/ü/nav.yaml").read_bytes() == b"a"
    assert made.archive("/home/pi") == release(files=PROJECT_FILES).archive("/home/pi")


@pytest.mark.parametrize("shell", EACH_SHELL)
def test_the_checksum_is_what_the_probe_finds(tmp_path: Path, shell: str) -> None:
    """The order of names too, which may not depend on a language."""
    names: tuple[str, ...] = (
        "ü",
        "Z",
        "a",
        "a-b",
        "a/b",
        "a.b",
        "_",
        "ﬀ",
        "𝄞",
        r"back\slash",
        "-rf",
        "c d",
        '"$`',
    )
    if shell == "busybox":  # its own sha256sum prints a backslash as it is; robots have that of coreutils
        names = tuple(name for name in names if "\\" not in name)
    files = {name if name != "a" else "a0": File(data=name.encode()) for name in names}
    made = release(files=replace(PROJECT_FILES, files={**PROJECT_FILES.files, **files}))
    unpacked(made, tmp_path)
    script = "find . -type f -print | LC_ALL=C sort | tr '\\n' '\\0' | xargs -0 -r sha256sum | sha256sum"
    argv = (shell, *(("sh",) if shell == "busybox" else ()), "-c", script)
    found = subprocess.run(argv, cwd=tmp_path, check=True, capture_output=True, text=True).stdout.split()[0]
    assert made.checksum("/home/pi") == found


VALUES = st.text(st.characters(exclude_characters="\0", codec="utf-8"), max_size=40)


# Two processes for each example: few examples of many values.
@settings(
    max_examples=4,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.large_base_example],
)
@given(values=st.lists(VALUES, min_size=50, max_size=50))
@example(
    values=[
        "$",
        "$$",
        "${A}",
        "'\"",
        "\\",
        "\n\r\t",
        "\x01\x1f\x7f\x85\x9f\u2028\u2029\ufeff",
        "\ufffe\uffff𝄞",
    ]
)
@example(values=["null", "true", "1e3", " a ", "a: b #c", "${A:?}", "$${A}", f"{HOME}/x"])
def test_compose_reads_the_same_values_again(tmp_path: Path, values: list[str]) -> None:
    """Byte for byte, whatever they are: from the robot's values through both Composes into the container."""
    names = [f"V{number}" for number in range(len(values))]
    path = tmp_path / "compose.yaml"
    path.write_text(f"services: {{node: {{image: x, environment: {names}}}}}")
    given_values = dict(zip(names, values, strict=True))
    with desktop.opened([path]) as project:
        stack = read(desktop.resolve(project, environment=given_values), project)
        made = compose(robot="pi1", stack=stack, project=project, files=FILES, images={"node": IMAGE})
    there = tmp_path / "there"
    there.mkdir(exist_ok=True)
    (there / "compose.yaml").write_bytes(made.files("/home/pi")["compose.yaml"].data)
    argv = (*desktop.program(), "--file", "compose.yaml", "config", "--format", "json")
    done = subprocess.run(argv, cwd=there, env={"HOME": "/home/pi"}, check=True, capture_output=True)
    again = json.loads(done.stdout)["services"]["node"]["environment"]
    expected = {name: value.replace(HOME, "/home/pi") for name, value in given_values.items()}
    assert {name: value.replace("$$", "$") for name, value in again.items()} == expected


def test_a_path_of_data_is_a_path() -> None:
    """The whole project as data: no dot is left in it."""
    volumes = [{"type": "bind", "source": HERE, "target": "/ws"}]
    made = release({"volumes": volumes}, files=ProjectFiles(data=frozenset({"."})))
    assert node(made)["volumes"][0]["source"] == "/home/pi/.fleet/stacks/robot/data"


def test_a_release_of_systemds_has_the_policies_beside_its_compose_file() -> None:
    """With the number of retries, which is in no restart policy any more; another policy is another release."""
    made = {}
    for restart in ("on-failure:3", "on-failure", "always"):
        of = samples.stack(talker={"image": "talker", "restart": restart})
        made[restart] = compose(
            robot="pi1",
            boot="systemd",
            stack=of,
            project=samples.PROJECT,
            files=ProjectFiles(),
            images={"talker": samples.TALKER},
        )
        assert made[restart].files("/home/pi")["services"].data == f"talker={restart}\n".encode()
    assert len({one.id for one in made.values()}) == 3
    limited = made["on-failure:3"]
    again = releases.unpacked(
        limited.archive(HOME), name=limited.id, stack="talker", robot="pi1", images=(samples.TALKER,)
    )
    assert again.files("/home/pi") == limited.files("/home/pi")


def test_a_release_that_systemd_starts_has_no_restart_policy_of_dockers() -> None:
    """Docker would start it before network and clock. What must run is said as before; a release of Docker's has no new file."""
    images = dict.fromkeys(samples.STACK.services, samples.TALKER)
    given: dict[str, Any] = {
        "stack": samples.STACK,
        "project": samples.PROJECT,
        "files": FILES,
        "images": images,
    }
    made = {"docker": compose(robot="pi1", **given), "systemd": compose(robot="pi1", boot="systemd", **given)}
    services = {boot: json.loads(one.compose)["services"]["talker"] for boot, one in made.items()}
    assert [services[boot]["restart"] for boot in made] == ["unless-stopped", "no"]
    docker, systemd = (made[boot].files("/home/pi") for boot in made)
    assert systemd.keys() - docker.keys() == {"boot"}
    assert systemd["services"] == docker["services"]
    assert made["docker"].id != made["systemd"].id
    data = made["systemd"].archive(HOME)
    again = releases.unpacked(
        data, name=made["systemd"].id, stack="talker", robot="pi1", images=(samples.TALKER,)
    )
    assert again.files("/home/pi") == systemd
