"""The program that builds packages in the image: names of dependencies, what has changed, and the first error."""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import yaml

if TYPE_CHECKING:
    from types import ModuleType

ROOT = Path(__file__).parents[3]
# catkin_pkg 1.1 reads conditions with names that pyparsing 3.3 gives up.
OLD_NAMES = pytest.mark.filterwarnings("ignore::DeprecationWarning")

# Debian bookworm, as `apt_knows` gives it.
KNOWN = {
    "libroscpp-dev": ["libroscpp4d", "python3", "libboost-filesystem-dev", "librosconsole-dev"],
    "libstd-msgs-dev": ["python3-std-msgs", "ros-std-msgs"],
    "python3-std-msgs": ["python3-genpy"],
    "ros-std-msgs": [],
    "python3-numpy": ["libc6"],
    "libeigen3-dev": [],
}

# g++ 12.2 and make, a name that does not exist.
GCC = """\
[ 50%] Building CXX object CMakeFiles/listener.dir/src/listener.cpp.o
listener/src/listener.cpp: In function 'int main(int, char**)':
listener/src/listener.cpp:43:10: error: 'spn' is not a member of 'ros'; did you mean 'spin'?
   43 |     ros::spn();
      |          ^~~
      |          spin
gmake[2]: *** [CMakeFiles/listener.dir/build.make:76: CMakeFiles/listener.dir/src/listener.cpp.o] Error 1
gmake: *** [Makefile:136: all] Error 2
"""

# CMake 3.25, a dependency that package.xml does not name.
CMAKE = """\
-- Using CATKIN_ENABLE_TESTING: OFF
CMake Error at /sysroot/usr/share/catkin/cmake/catkinConfig.cmake:82 (find_package):
  Could not find a package configuration file provided by "sensor_msgs" with
  any of the following names:

    sensor_msgsConfig.cmake
    sensor_msgs-config.cmake

-- Configuring incomplete, errors occurred!
"""

# GNU ld 2.40.
LD = """\
[100%] Linking CXX executable devel/lib/listener/listener
/usr/bin/ld: CMakeFiles/listener.dir/src/listener.cpp.o: in function `main':
listener.cpp:(.text.startup+0x134): undefined reference to `nowhere(int)'
collect2: error: ld returned 1 exit status
gmake: *** [Makefile:136: all] Error 2
"""


@pytest.fixture(scope="module")
def program() -> ModuleType:
    """The program, loaded from its file: `docker/` is no package."""
    spec = importlib.util.spec_from_file_location("catkin_packages", ROOT / "docker/catkin_packages.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def package(folder: Path, name: str, *depends: str) -> None:
    """Write a package.xml."""
    lines = "".join(f"<depend>{one}</depend>" for one in depends)
    folder.mkdir(parents=True)
    (folder / "package.xml").write_text(
        f'<package format="3"><name>{name}</name><version>1.0.0</version><description>x</description>'
        f'<maintainer email="fleet@example.org">a</maintainer><license>x</license>'
        f"<buildtool_depend>catkin</buildtool_depend>{lines}</package>"
    )


def said(error: pytest.ExceptionInfo[SystemExit], capsys: pytest.CaptureFixture[str]) -> str:
    """The sentence with which the program ended."""
    assert error.value.code == 1
    return capsys.readouterr().out


def test_the_example_s_dependencies_are_those_of_its_package_xml(program: ModuleType, tmp_path: Path) -> None:
    """With the tools that every image has."""
    program.needs(ROOT / "packages", tmp_path / "needs")
    where = "packages/listener/package.xml"
    build = (tmp_path / "needs/build").read_text().splitlines()
    run = (tmp_path / "needs/run").read_text().splitlines()
    assert build == [f"catkin\t{where}", f"roscpp\t{where}", f"std_msgs\t{where}"]
    assert {line.partition("\t")[0] for line in run} == {"roscpp", "std_msgs", *program.TOOLS}


def test_packages_of_the_folder_are_not_looked_for_elsewhere(program: ModuleType, tmp_path: Path) -> None:
    """A node and the messages that it uses."""
    package(tmp_path / "node", "node", "my_msgs", "roscpp")
    package(tmp_path / "deep/msgs", "my_msgs", "std_msgs")
    build, _ = program.dependencies(program.packages(tmp_path))
    assert build == {
        "catkin": "packages/deep/msgs/package.xml",
        "std_msgs": "packages/deep/msgs/package.xml",
        "roscpp": "packages/node/package.xml",
    }


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "packages/ holds no package.xml. Cure: put a catkin package there, or set PACKAGES"),
        ("<package", "packages/node/package.xml"),
        ('<package format="3"><name>node</name></package>', '"version"'),
    ],
)
def test_a_folder_without_packages_is_one_sentence(
    program: ModuleType, tmp_path: Path, text: str | None, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """And so is a package.xml that cannot be read."""
    if text:
        (tmp_path / "node").mkdir()
        (tmp_path / "node/package.xml").write_text(text)
    with pytest.raises(SystemExit) as error:
        program.packages(tmp_path)
    out = said(error, capsys)
    assert words in out
    assert len(out.splitlines()) == 1


def test_dependencies_become_debian_s_packages(program: ModuleType) -> None:
    """Headers for the build; for the robot, libraries and Python modules."""
    keys = dict.fromkeys(("roscpp", "std_msgs", "python3-numpy", "eigen"), "x/package.xml")
    table = {"eigen": ["libeigen3-dev"]}
    build = program.chosen(keys, KNOWN, table=table, run=False)
    assert build == [
        *("libeigen3-dev", "libroscpp-dev", "libstd-msgs-dev"),
        *("python3-numpy", "python3-std-msgs", "ros-std-msgs"),
    ]
    run = program.chosen(keys, KNOWN, table=table, run=True)
    assert run == ["libroscpp4d", "python3-numpy", "python3-std-msgs", "ros-std-msgs"]


def test_an_image_of_the_ros_project_has_names_of_its_own(program: ModuleType) -> None:
    """ros-noetic-std-msgs; what is not of ROS has the distribution's name."""
    known: dict[str, list[str]] = {"ros-noetic-std-msgs": [], "python3-numpy": []}
    keys = dict.fromkeys(("std_msgs", "python3-numpy"), "x/package.xml")
    picked = program.chosen(keys, known, table={}, run=True, distribution="noetic")
    assert picked == ["python3-numpy", "ros-noetic-std-msgs"]


def test_an_unknown_dependency_is_one_sentence(
    program: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    """It says where the name stands, and where a name of Debian can be written."""
    with pytest.raises(SystemExit) as error:
        program.chosen({"std_msg": "packages/a/package.xml"}, KNOWN, table={}, run=False)
    assert said(error, capsys) == (
        "packages/a/package.xml: no package is known for the dependency std_msg. Cure: correct its name, "
        "or write into docker/rosdep.yaml: std_msg: {debian: [PACKAGE]}\n"
    )


def test_the_table_has_rosdep_s_format() -> None:
    """So that people can copy lines of rosdep's own."""
    table = yaml.safe_load((ROOT / "docker/rosdep.yaml").read_text(encoding="utf-8"))
    assert all([*value] == ["debian"] and value["debian"] for value in table.values())


def test_files_with_the_same_bytes_keep_their_time(program: ModuleType, tmp_path: Path) -> None:
    """Else make would compile all of a package again, in each new checkout."""
    source, target = tmp_path / "source", tmp_path / "target"
    (source / "src").mkdir(parents=True)
    target.mkdir()
    for name in ("same", "changed", "gone"):
        (source / f"src/{name}.cpp").write_text(name)
    program.copy_changed(source, target)
    old = 1_000_000_000
    for path in target.rglob("*.cpp"):
        os.utime(path, (old, old))
    (source / "src/changed.cpp").write_text("another")
    (source / "src/gone.cpp").unlink()
    (source / "src/run").symlink_to("same.cpp")
    (source / "src/same.cpp").touch()
    program.copy_changed(source, target)
    assert {path.name for path in target.rglob("*")} == {"src", "same.cpp", "changed.cpp", "run"}
    assert (target / "src/same.cpp").stat().st_mtime == old
    assert (target / "src/changed.cpp").stat().st_mtime > old
    assert program.digest(source) == program.digest(target)


def test_a_folder_may_become_a_file(program: ModuleType, tmp_path: Path) -> None:
    """And the other way round."""
    for number, (folder, file) in enumerate((("a", "b"), ("b", "a"))):
        (tmp_path / f"{number}" / folder).mkdir(parents=True)
        (tmp_path / f"{number}" / folder / "x").write_text("x")
        (tmp_path / f"{number}" / file).write_text("y")
    target = tmp_path / "target"
    target.mkdir()
    for number in (0, 1, 0):
        program.copy_changed(tmp_path / f"{number}", target)
        assert program.digest(tmp_path / f"{number}") == program.digest(target)


@pytest.mark.parametrize(
    ("output", "lines"),
    [
        (GCC, GCC.splitlines()[2:6]),
        (LD, LD.splitlines()[2:4]),
        (CMAKE, [*CMAKE.splitlines()[1:3], "Cure: <depend>sensor_msgs</depend> in package.xml"]),
        ("one\ntwo\n", ["one", "two"]),
    ],
    ids=["compiler", "linker", "cmake", "unknown"],
)
def test_the_first_error_is_shown(program: ModuleType, output: str, lines: list[str]) -> None:
    """Make's own lines, and those before it, are in the log."""
    assert program.first_error(output) == lines


def test_a_long_error_is_cut(program: ModuleType) -> None:
    """A template's error has hundreds of lines."""
    text = "a.cpp:1: error: x\n" + "note\n" * 500
    assert len(program.first_error(text)) == program.SHOWN


def test_libraries_are_looked_up_in_what_was_unpacked(program: ModuleType, tmp_path: Path) -> None:
    """The package with the library counts, not the one with the link that the linker reads."""
    lib = "./usr/lib/aarch64-linux-gnu"
    (tmp_path / "libroscpp4d").write_text(f"{lib}/\n{lib}/libroscpp.so.4d\n")
    (tmp_path / "libroscpp-dev").write_text(f"{lib}/libroscpp.so.4d\n{lib}/libroscpp.so\n")
    needed = {"libroscpp.so.4d": "listener", "libc.so.6": "listener"}
    assert program.owners(needed, tmp_path) == ({"libroscpp4d"}, {"libc.so.6"})


def test_a_changed_base_begins_anew(program: ModuleType, tmp_path: Path) -> None:
    """Another list of its packages, and another file where no list of packages leads to."""
    (tmp_path / "opt/ros/include").mkdir(parents=True)
    (tmp_path / "var/lib/dpkg/status.d").mkdir(parents=True)
    seen = [program.headers(tmp_path), program.headers(tmp_path)]
    for name in ("var/lib/dpkg/status", "var/lib/dpkg/status.d/libroscpp-dev", "opt/ros/include/ros.h"):
        for text in ("1", "22"):
            (tmp_path / name).write_text(text)
            seen.append(program.headers(tmp_path))
    assert len(set(seen)) == len(seen) - 1


@OLD_NAMES
def test_what_a_package_is_compiled_with(program: ModuleType, tmp_path: Path) -> None:
    """What it needs exports more, also if that is not needed to build it; conditions are those of this ROS."""
    package(tmp_path / "headers", "headers")
    package(tmp_path / "ros2", "ros2")
    package(tmp_path / "between", "between")
    package(tmp_path / "node", "node", "between", "roscpp")
    for name, line in (
        ("between", "<build_export_depend>headers</build_export_depend>"),
        ("node", '<build_depend condition="$ROS_VERSION == 2">ros2</build_depend>'),
    ):
        file = tmp_path / name / "package.xml"
        file.write_text(file.read_text().replace("</package>", f"{line}</package>"))
    own = {package.name: package for package in program.packages(tmp_path).values()}
    assert program.compiled_with(own["node"], own) == {"between", "headers"}
    assert program.compiled_with(own["between"], own) == set()


@OLD_NAMES
def test_the_order_knows_the_conditions(program: ModuleType, tmp_path: Path) -> None:
    """And the environment of the nodes' CMake is as it was."""
    package(tmp_path / "z", "z")
    package(tmp_path / "a", "a")
    file = tmp_path / "a/package.xml"
    line = '<build_depend condition="$ROS_DISTRO == noetic">z</build_depend>'
    file.write_text(file.read_text().replace("</package>", f"{line}</package>"))
    before = dict(os.environ)
    assert [path for path, _ in program.ordered(tmp_path)] == ["z", "a"]
    assert dict(os.environ) == before


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ("--build", "listener does not compile:"),
        ("-S", "listener cannot be configured by CMake:"),
        ("--install", "listener cannot be installed: an install(...) of its CMakeLists.txt fails:"),
    ],
)
def test_each_step_of_cmake_has_its_words(
    program: ModuleType, tmp_path: Path, option: str, words: str, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """CMake is called three times, and each time something else can be wrong."""
    monkeypatch.setattr(program, "toolchain", lambda _: "")
    builder = program.Builder({}, triplet="x", cache=tmp_path)
    with pytest.raises(SystemExit) as error:
        builder._run("listener", tmp_path, "sh", "-c", "echo CMake Error: x; exit 1", option)  # noqa: SLF001
    assert said(error, capsys).endswith(f"\n{words}\nCMake Error: x\n")


@pytest.mark.parametrize("text", ["boost: [libboost]", "boost: {ubuntu: [x]}", "- boost", "a: {", "boost: 1"])
def test_a_table_that_is_wrong_is_one_sentence(
    program: ModuleType, tmp_path: Path, text: str, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """People write into it."""
    (tmp_path / "rosdep.yaml").write_text(text)
    monkeypatch.setattr(program, "HERE", tmp_path)
    with pytest.raises(SystemExit) as error:
        program.names(tmp_path / "run")
    out = said(error, capsys)
    assert out.startswith("docker/rosdep.yaml cannot be read: ")
    assert len(out.splitlines()) == 1


def test_the_history_of_packages_is_not_their_source() -> None:
    """A fetch changes files in .git, and would make another build."""
    for name in (".dockerignore", "docker/packages.Dockerfile.dockerignore"):
        assert "**/.git" in (ROOT / name).read_text(encoding="utf-8").splitlines()
