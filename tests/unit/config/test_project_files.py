from __future__ import annotations

import os
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, Literal

import pytest

from fleet.config import project_files
from fleet.config.compose import Project
from fleet.config.project_files import File, ProjectFiles, collect, on_robot
from fleet.config.stack import Mount, Stack
from fleet.errors import ComposeError

if TYPE_CHECKING:
    from collections.abc import Iterable


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The project's folder."""
    made = tmp_path / "robot"
    made.mkdir()
    return made


FOLDER = File(folder=True, mode=0o755)


def mount(
    path: str, target: str = "/there", *, read_only: bool = False, kind: Literal["bind", "config", "secret"] = "bind"
) -> Mount:  # fmt: skip
    return Mount(
        service="node",
        path=PurePosixPath(path),
        target=target,
        read_only=read_only or kind != "bind",
        kind=kind,
    )


def collected(
    folder: Path, *mounts: Mount, allowed: Iterable[Path] = (), lines: Iterable[str] = ()
) -> ProjectFiles:
    """What travels; ``lines`` are those of the Compose file."""
    (folder / "compose.yaml").write_text("\n".join(lines) + "\n")
    project = Project(files=(folder / "compose.yaml",), real=folder, folder=folder)
    stack = Stack(name="robot", services={}, mounts=mounts, model={})
    return collect(stack, project, allowed=allowed)


def problems(folder: Path, *mounts: Mount, **more: Any) -> list[str]:  # noqa: ANN401
    with pytest.raises(ComposeError) as caught:
        collected(folder, *mounts, **more)
    return str(caught.value).replace(str(folder), "P").splitlines()


def test_a_file_that_is_read_belongs_to_the_release(folder: Path) -> None:
    """It is replaced with it."""
    (folder / "nav.yaml").write_bytes(b"speed: 1\n\x00\xff")
    found = collected(folder, mount("nav.yaml", read_only=True))
    assert found == ProjectFiles(files={"nav.yaml": File(data=b"speed: 1\n\x00\xff")})


def test_a_file_that_is_written_is_the_robots(folder: Path) -> None:
    """The robot starts with it, and its own changes are kept."""
    (folder / "nav.yaml").write_text("a")
    found = collected(folder, mount("nav.yaml"))
    assert found == ProjectFiles(seeds={"nav.yaml": File(data=b"a")}, data=frozenset({"nav.yaml"}))


def test_a_folder_that_is_not_there_is_the_robots(folder: Path) -> None:
    """It is made empty on the robot, and nothing travels."""
    found = collected(folder, mount("maps"), mount("logs/deep"), mount("maps.d", "/maps"))
    names = ("logs/deep", "maps", "maps.d")
    assert found == ProjectFiles(folders=names, data=frozenset(names))


def test_a_folder_goes_whole(folder: Path) -> None:
    """With what is below it, its links, its executable bits; an empty folder that is written is made."""
    (folder / "config/sub").mkdir(parents=True)
    (folder / "config/sub/a").write_text("a")
    (folder / "config/run").write_text("#!")
    (folder / "config/run").chmod(0o755)
    (folder / "config/link").symlink_to("sub/a")
    (folder / "config/dangling").symlink_to("/nowhere")
    (folder / "config/sub").chmod(0o775)
    files = {
        "config": FOLDER,
        "config/sub": FOLDER,
        "config/sub/a": File(data=b"a"),
        "config/run": File(data=b"#!", mode=0o755),
        "config/link": File(link="sub/a", mode=0o777),
        "config/dangling": File(link="/nowhere", mode=0o777),
    }
    assert collected(folder, mount("config", read_only=True)) == ProjectFiles(files=files)
    written = collected(folder, mount("config"))
    assert written == ProjectFiles(seeds=files, folders=("config",), data=frozenset({"config"}))


def test_an_empty_folder(folder: Path) -> None:
    """It is the robot's data if it is written."""
    (folder / "maps").mkdir()
    (folder / "maps/deep").mkdir()
    found = collected(folder, mount("maps"))
    assert (found.folders, found.seeds) == (("maps",), {"maps": FOLDER, "maps/deep": FOLDER})
    assert collected(folder, mount("maps", read_only=True)).files == found.seeds


def test_the_whole_project(folder: Path) -> None:
    """``.:/ws`` is legal; paths have no dot in them."""
    (folder / "src").mkdir()
    (folder / "src/a.py").write_text("a")
    assert set(collected(folder, mount(".", read_only=True)).files) == {
        ".",
        "compose.yaml",
        "src",
        "src/a.py",
    }


def test_a_link_that_is_mounted_is_followed(folder: Path) -> None:
    """The container would see what it leads to."""
    (folder / "real").write_text("a")
    (folder / "link").symlink_to("real")
    assert collected(folder, mount("link", read_only=True)).files == {"link": File(data=b"a")}


def test_who_reads_what_another_writes_sees_the_same(folder: Path) -> None:
    """A read-only mount that shares a path with a writable one is data too."""
    (folder / "maps").mkdir()
    (folder / "maps/house").write_text("a")
    (folder / "other").write_text("b")
    found = collected(
        folder, mount("maps/house", read_only=True), mount("maps"), mount("other", read_only=True)
    )
    assert found.seeds == {"maps": FOLDER, "maps/house": File(data=b"a")}
    assert found.files == {"other": File(data=b"b")}
    assert found.data == {"maps", "maps/house"}


@pytest.mark.parametrize(
    ("here", "travels"),
    [
        (0o664, 0o644),
        (0o640, 0o600),
        (0o400, 0o600),
        (0o500, 0o700),
        (0o775, 0o755),
        (0o666, 0o666),
        (0o777, 0o777),
        (0o4755, 0o755),
    ],
)
def test_modes_of_files(folder: Path, here: int, travels: int) -> None:
    """A umask that differs in the group's letters changes no release; a key that only its owner reads stays one."""
    (folder / "a").write_text("a")
    (folder / "a").chmod(here)
    for one in (mount("a", read_only=True), mount("a", kind="secret")):
        assert oct(collected(folder, one).files["a"].mode) == oct(travels)


@pytest.mark.parametrize(
    ("here", "travels"), [(0o775, 0o755), (0o750, 0o700), (0o777, 0o777), (0o1777, 0o1777)]
)
def test_modes_of_folders(folder: Path, here: int, travels: int) -> None:
    """One that is open to all is open on the robot: a container that is not root writes to it."""
    (folder / "logs").mkdir()
    (folder / "logs").chmod(here)
    assert oct(collected(folder, mount("logs")).seeds["logs"].mode) == oct(travels)


def test_a_digest_is_that_of_all() -> None:
    """Bytes, mode, kind."""
    different = File(data=b"a"), File(data=b"a", mode=0o755), File(link="a"), File(folder=True)
    assert len({file.digest for file in different}) == len(different)


@pytest.mark.parametrize("name", [b"caf\xe9.pgm", b"two\nlines", b"bell\a"])
def test_a_name_that_cannot_travel(folder: Path, name: bytes) -> None:
    """Lists of names, on the robot and here, have one in each line, and are UTF-8. Other odd names are fine."""
    (folder / "maps").mkdir()
    for odd in ("back\\slash", "-rf", " a b ", "$HOME"):
        (folder / "maps" / odd).write_text("")
    Path(os.fsdecode(os.fsencode(folder) + b"/maps/" + name)).write_text("")
    (problem,) = problems(folder, mount("maps"), lines=["maps"])
    assert problem.startswith("P/compose.yaml:1: services.node: ./maps has a name that cannot travel: '")
    assert problem.endswith("; rename it, or name it in .fleetignore")
    assert problem.isascii()


def test_nobody_makes_what_must_exist(folder: Path) -> None:
    """``create_host_path: false`` is there so that a typing error is no empty folder."""
    must = Mount(service="node", path=PurePosixPath("maps"), target="/maps", read_only=False, must_exist=True)
    what = "./maps is not there, and `create_host_path: false` says that it must be; make it here, or remove that line"
    assert problems(folder, must, lines=["maps"]) == [f"P/compose.yaml:1: services.node: {what}"]


def test_what_stays_here(folder: Path) -> None:
    """``.fleetignore`` is written as ``.gitignore`` is, and holds for folders that are mounted."""
    for name in ("config/a.yaml", "config/a.bak", "config/.git/x", "config/keep.bak"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(name)
    (folder / ".fleetignore").write_text("# bags\n*.bak\n.git/\n!keep.bak\n")
    found = collected(folder, mount("config", read_only=True))
    assert set(found.files) == {"config", "config/a.yaml", "config/keep.bak"}


@pytest.mark.parametrize("name", ["a$b", "ä ö", "it's", 'say "hi"', "a\\b"])
def test_odd_names(folder: Path, name: str) -> None:
    """They are names like any other."""
    (folder / name).write_text("a")
    assert set(collected(folder, mount(name, read_only=True)).files) == {name}


def test_a_file_in_a_folder_of_a_name_that_begins_with_a_dot(folder: Path) -> None:
    """The dot is a part of the name."""
    (folder / ".hidden").mkdir()
    (folder / ".hidden/.a").write_text("a")
    assert set(collected(folder, mount(".hidden", read_only=True)).files) == {".hidden", ".hidden/.a"}


# --- Refused


def test_too_large(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the whole size, and three ways out."""
    monkeypatch.setattr(project_files, "LIMIT", 1000)
    (folder / "bags").mkdir()
    for name in ("a", "b", "c"):
        (folder / "bags" / name).write_bytes(bytes(700))
    (folder / "one.bag").write_bytes(bytes(2500))
    lines = ("services:", "- ./bags:/bags", "- ./one.bag:/one.bag:ro")
    cure = "put it into the image, leave it to the robot (absolute path), or name it in .fleetignore"
    assert problems(folder, mount("bags"), mount("one.bag", read_only=True), lines=lines) == [
        f"P/compose.yaml:2: services.node: ./bags has more than 1.0 kB (2.1 kB); {cure}",
        f"P/compose.yaml:3: services.node: ./one.bag has more than 1.0 kB (2.5 kB); {cure}",
    ]


def test_what_is_ignored_is_not_too_large(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """That is the cure that was named."""
    monkeypatch.setattr(project_files, "LIMIT", 1000)
    (folder / "config").mkdir()
    (folder / "config/x.bag").write_bytes(bytes(5000))
    (folder / ".fleetignore").write_text("*.bag\n")
    assert collected(folder, mount("config")).seeds == {"config": FOLDER}


def test_every_problem_at_once(folder: Path) -> None:
    """Each with its line, each once."""
    os.mkfifo(folder / "pipe")
    lines = (
        "- ../../x:/x",
        "- ./nav.yaml:/nav.yaml",
        "- ./gone:/gone:ro",
        "file: ./key",
        "- ./pipe:/pipe:ro",
    )
    mounts = (
        mount("../../x", "/x"),
        mount("nav.yaml", "/nav.yaml"),
        mount("gone", "/gone", read_only=True),
        mount("gone", "/again", read_only=True),
        mount("key", kind="secret"),
        mount("pipe", "/pipe", read_only=True),
    )
    assert sorted(problems(folder, *mounts, lines=lines)) == [
        "P/compose.yaml:1: services.node: ../../x leaves the project's folder; move it into the folder, or allow it with `outside:`",
        "P/compose.yaml:2: services.node: ./nav.yaml is not there, and looks like a file; make the file; for a folder of the robot, `mkdir` it here",
        "P/compose.yaml:3: services.node: ./gone is not there, and is mounted read-only: it would be an empty folder for ever; make the file, or correct its name",
        "P/compose.yaml:4: services.node: ./key is not there; make the file, or correct its name",
        "P/compose.yaml:5: services.node: ./pipe is neither a file nor a folder; name it by its absolute path if it is the robot's",
    ]


def test_the_line_is_of_the_path_and_not_of_a_longer_one(folder: Path) -> None:
    """``maps-old`` is not ``maps``."""
    lines = ("- ./gone-old:/old", "- ./gone:/gone:ro")
    assert problems(folder, mount("gone", read_only=True), lines=lines)[0].startswith("P/compose.yaml:2: ")


def test_a_fifo_in_a_folder_is_passed_over(folder: Path) -> None:
    """It has no content that could travel, and reading it would never end."""
    (folder / "run").mkdir()
    os.mkfifo(folder / "run/pipe")
    (folder / "run/a").write_text("a")
    assert set(collected(folder, mount("run", read_only=True)).files) == {"run", "run/a"}


def test_a_link_out_of_the_project(folder: Path) -> None:
    """A mounted link is what leads out of the folder, as ``..`` does; it needs the same permission."""
    (folder.parent / "home").mkdir()
    (folder.parent / "home/id_rsa").write_text("secret")
    (folder / "key").symlink_to("../home/id_rsa")
    assert "leaves the project's folder" in problems(folder, mount("key", read_only=True))[0]
    found = collected(folder, mount("key", read_only=True), allowed=[folder.parent / "home"])
    assert found.files == {"key": File(data=b"secret")}


def test_outside_where_the_inventory_allows_it(folder: Path) -> None:
    """On the robot it lies inside all the same."""
    (folder.parent / "shared").mkdir()
    (folder.parent / "shared/a").write_text("a")
    found = collected(folder, mount("../shared", read_only=True), allowed=[folder.parent / "shared"])
    assert found.files == {"_up/shared": FOLDER, "_up/shared/a": File(data=b"a")}
    other = problems(folder, mount("../shared", read_only=True), allowed=[folder.parent / "sha"])
    assert len(other) == 1


def test_what_cannot_be_read(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Which file it is, in the system's words."""
    (folder / "config").mkdir()
    (folder / "config/key").write_text("x")

    def refuse(path: Path) -> bytes:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "read_bytes", refuse)
    assert problems(folder, mount("config", read_only=True), lines=["- ./config:/c"]) == [
        "P/compose.yaml:1: services.node: ./config cannot be read: P/config/key: Permission denied; see its permissions"
    ]


def test_paths_on_the_robot() -> None:
    """``..`` has a name of its own there."""
    paths = {".": ".", "maps": "maps", "../a/b": "_up/a/b", "../../x": "_up/_up/x"}
    assert {path: on_robot(PurePosixPath(path)) for path in paths} == paths
