from __future__ import annotations

import json
import os
import subprocess
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from fleet.cli import console
from tests.support.project import FAB, ROOT, Done, Project

if TYPE_CHECKING:
    from collections.abc import Iterator

WRITTEN = ["inventory.yaml", "inventory.schema.json", "compose.yaml", "Dockerfile", ".dockerignore"]


@pytest.fixture
def empty(tmp_path: Path) -> Project:
    """A folder with nothing in it."""
    folder = tmp_path / "robots"
    folder.mkdir()
    return Project(folder=folder, robots={})


@pytest.mark.usefixtures("desktop")
def test_an_empty_folder_becomes_a_project(empty: Project) -> None:
    """It passes what a person tries next, and a second time nothing changes."""
    done = empty.fleet(
        "init", "--robots", "pi1=192.168.1.11,pi2=pi2.local", "--platform", "linux/arm/v7", "--user", "pi"
    )
    assert (done.code, done.out.splitlines()) == (0, [f"wrote {name}" for name in WRITTEN])
    assert "next: fleet trust, fleet provision, fleet build, fleet ship" in done.err
    robots = json.loads(empty.fleet("inventory", "--json").out)
    assert [(one["name"], one["address"], one["user"], one["platform"]) for one in robots] == [
        ("pi1", "192.168.1.11", "pi", "linux/arm/v7"),
        ("pi2", "pi2.local", "pi", "linux/arm/v7"),
    ]
    planned = empty.fleet("build", "--dry")
    assert (planned.code, planned.out.splitlines()[0]) == (0, "build robots:latest-armv7 for linux/arm/v7")
    before = {path.name: path.read_bytes() for path in empty.folder.iterdir()}
    again = empty.fleet("init", "--robots", "other")
    assert again.code == 0
    assert "kept inventory.yaml: it was there" in again.out
    assert "--robots had no effect: inventory.yaml was there" in again.err
    assert {path.name: path.read_bytes() for path in empty.folder.iterdir()} == before


@pytest.mark.usefixtures("desktop")
def test_a_workspace_of_ros_becomes_a_project(empty: Project) -> None:
    """The packages are found, and said."""
    package = empty.folder / "src/nav"
    (package / "launch").mkdir(parents=True)
    (package / "launch/nav.launch.py").touch()
    (package / "package.xml").write_text(
        "<package><name>nav</name><export><build_type>ament_python</build_type></export></package>"
    )
    done = empty.fleet("init", "--robots", "pi1", "--yes", "--distro", "humble")
    assert "found 1 ROS package: nav; built with ROS humble" in done.err
    assert "the robots will run: ros2 launch nav nav.launch.py" in done.err
    assert empty.fleet("build", "--dry").out.startswith("build nav:latest-arm64 for linux/arm64")


def test_a_dry_run_and_json(empty: Project) -> None:
    """What would be written is named; nothing is."""
    assert empty.fleet("init", "--dry").out.splitlines() == [f"would write {name}" for name in WRITTEN]
    assert list(empty.folder.iterdir()) == []
    found = json.loads(empty.fleet("init", "--json").out)
    assert found == [{"file": name, "state": "written"} for name in WRITTEN]


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (("--robots", "a b"), "--robots: 'a b' is not a name"),
        (("--platform", "arm64"), "there is no platform arm64\n  cure: did you mean 'linux/arm64'?"),
        (("--example", "--robots", "pi1"), "--robots has no effect with --example"),
    ],
)
def test_a_mistake_writes_nothing(empty: Project, words: tuple[str, ...], what: str) -> None:
    """It is a sentence, and exit code 2."""
    done = empty.fleet("init", *words)
    assert (done.code, what in done.err, list(empty.folder.iterdir())) == (2, True, [])


def test_a_person_is_asked_for_what_no_flag_says(empty: Project, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two questions; with flags, --yes, or an inventory, none."""
    questions: list[str] = []
    answers: Iterator[str] = iter(["pi7=10.0.0.7", "linux/amd64"])

    def ask(_: object, question: str, *, default: str) -> str:
        questions.append(question)
        return next(answers, default)

    monkeypatch.setattr(console.Screen, "ask", ask)
    assert empty.fleet("init", "--yes", "--dry").code == 0
    assert questions == []
    assert empty.fleet("init").code == 0
    assert len(questions) == 2
    (robot,) = json.loads(empty.fleet("inventory", "--json").out)
    assert (robot["name"], robot["address"], robot["platform"]) == ("pi7", "10.0.0.7", "linux/amd64")
    assert empty.fleet("init").code == 0
    assert len(questions) == 2


@pytest.mark.usefixtures("desktop")
def test_the_example_is_written_as_it_is(empty: Project) -> None:
    """Byte for byte the repository's files, programs executable, and the build can be planned."""
    done = empty.fleet("init", "--example")
    assert (done.code, "fleet lab.up" in done.err) == (0, True)
    paths = [path for path in empty.folder.rglob("*") if path.is_file()]
    assert len(paths) == len(done.out.splitlines()) > 10
    for path in paths:
        same = ROOT / path.relative_to(empty.folder)
        assert path.read_bytes() == same.read_bytes()
        assert os.access(path, os.X_OK) == os.access(same, os.X_OK)
    with (empty.folder / "inventory.yaml").open("a") as inventory:
        inventory.write("  mine: 10.0.0.1\n")
    assert empty.fleet("build", "--dry").out.startswith("build talker:latest-arm64 for linux/arm64")
    assert "mine\n" in empty.fab("inventory").out


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of packages of a computer where the wheel is installed."""
    folder = tmp_path_factory.mktemp("wheel")
    python = str(FAB.with_name("python"))
    build = (python, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder))
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (file,) = folder.glob("*.whl")
    with zipfile.ZipFile(file) as archive:
        for one in archive.infolist():
            target = Path(archive.extract(one, folder / "packages"))
            # As pip does: a program stays one.
            target.chmod(0o755 if one.external_attr >> 16 & 0o111 else 0o644)
    return folder / "packages"


def from_wheel(packages: Path, folder: Path, *words: str) -> Done:
    """Type ``fleet`` where only the wheel is: this repository is not on Python's path."""
    script = "import sys; sys.argv[0] = 'fleet'; from fleet.cli import main; main()"
    done = subprocess.run(
        (str(FAB.with_name("python")), "-c", script, *words),
        cwd=folder,
        env={"PATH": os.environ["PATH"], "HOME": str(folder), "PYTHONPATH": str(packages), "LANG": "C.UTF-8"},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    return Done(code=done.returncode, out=done.stdout, err=done.stderr)


@pytest.mark.usefixtures("desktop")
def test_the_wheel_is_enough(wheel: Path, tmp_path: Path) -> None:
    """In an empty folder: the example, its build, a project of one's own, and the recipe of the lab."""
    example, own = tmp_path / "example", tmp_path / "own"
    for folder in (example, own):
        folder.mkdir()
    done = from_wheel(wheel, example, "init", "--example")
    assert (done.code, done.err.count("Traceback")) == (0, 0), done.err
    for path in [path for path in example.rglob("*") if path.is_file()]:
        same = ROOT / path.relative_to(example)
        assert path.read_bytes() == same.read_bytes()
        assert os.access(path, os.X_OK) == os.access(same, os.X_OK)
    assert from_wheel(wheel, own, "init", "--robots", "pi1=10.0.0.1").code == 0
    assert '"pi1"' in from_wheel(wheel, own, "inventory", "--json").out
    assert from_wheel(wheel, own, "build", "--dry").out.startswith("build own:latest-arm64")
    script = (
        "import fleet; from fleet.lab import lifecycle, virtual_pi;"
        "print(fleet.__file__, virtual_pi.image_tag(lifecycle.RECIPE))"
    )
    asked = subprocess.run(
        (str(FAB.with_name("python")), "-c", script),
        cwd=own,
        env={"PYTHONPATH": str(wheel)},
        capture_output=True,
        text=True,
        check=True,
    )
    from fleet.lab import lifecycle, virtual_pi  # noqa: PLC0415

    assert asked.stdout.split() == [str(wheel / "fleet/__init__.py"), virtual_pi.image_tag(lifecycle.RECIPE)]
    assert (wheel / "fleet/lab/recipe/get-docker.sh").is_file()
    assert os.access(wheel / "fleet/lab/recipe/first-process", os.X_OK)
