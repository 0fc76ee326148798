from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from fleet.errors import UsageError
from fleet.starter.packages import DEEPEST, Package, find

if TYPE_CHECKING:
    from pathlib import Path

CATKIN = "<buildtool_depend>catkin</buildtool_depend>"
AMENT = "<export><build_type>ament_cmake</build_type></export>"
BOTH = (
    '<buildtool_depend condition="$ROS_VERSION == 1">catkin</buildtool_depend>'
    '<buildtool_depend condition="$ROS_VERSION == 2">ament_cmake</buildtool_depend>'
)


def manifest(folder: Path, *, name: str = "", says: str = AMENT) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    text = f'<?xml version="1.0"?>\n<package format="3"><name>{name or folder.name}</name>{says}</package>\n'
    (folder / "package.xml").write_text(text)
    return folder


def file(path: Path, text: str = "", *, mode: int = 0o644) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    path.chmod(mode)


@pytest.mark.parametrize(
    ("says", "ros"),
    [
        (CATKIN, {1}),
        (AMENT, {2}),
        ("<buildtool_depend>ament_cmake_auto</buildtool_depend>", {2}),
        ("<export><build_type>ament_python</build_type></export>", {2}),
        (BOTH, {1, 2}),
        ("<export><build_type>cmake</build_type></export>", {1, 2}),
    ],
)
def test_the_generation_of_ros_is_that_of_the_build_tools(tmp_path: Path, says: str, ros: set[int]) -> None:
    """Plain CMake packages fit both."""
    manifest(tmp_path / "src/nav", says=says)
    assert find(tmp_path) == (Package(name="nav", folder="src/nav", ros=frozenset(ros)),)


def test_packages_are_found_where_people_have_them(tmp_path: Path) -> None:
    """In a workspace, in a folder of it, in the folder itself; not in what builds have made or tools ignore."""
    for name in ("src/a", "src/group/b", "src/a/inner", "build/a", "install/a", ".git/x", "src/off/c"):
        manifest(tmp_path / name)
    (tmp_path / "src/off/COLCON_IGNORE").touch()
    manifest(tmp_path.joinpath(*"abcdef"[:DEEPEST]))
    manifest(tmp_path.joinpath(*"uvwxyzz"[: DEEPEST + 1]))
    assert [package.folder for package in find(tmp_path)] == ["a/b/c/d/e/f", "src/a", "src/group/b"]
    assert [package.folder for package in find(tmp_path / "src/a")] == ["."]
    assert find(tmp_path / "src/off") == ()


def test_a_link_to_a_folder_above_ends(tmp_path: Path) -> None:
    """Links are not followed."""
    manifest(tmp_path / "src/a")
    (tmp_path / "src/again").symlink_to(tmp_path)
    assert len(find(tmp_path)) == 1


def test_what_a_package_of_ros_2_can_start(tmp_path: Path) -> None:
    """Launch files in three languages, entry points of Python, executables of C++; no tests, no comments."""
    package = manifest(tmp_path / "nav")
    for name in ("a.launch.py", "b_launch.py", "c.launch.xml", "d.launch.yaml", "e.launch", "helper.py"):
        file(package / "launch" / name)
    file(package / "test/t.launch.py")
    file(
        package / "setup.py",
        "setup(entry_points={'console_scripts': [\n  'look = nav.look:main',\n  'blink=nav.blink:main'], 'x': ['no = a.b:c']})",
    )
    file(
        package / "CMakeLists.txt",
        "add_executable(driver a.cpp)\n# add_executable(old a.cpp)\nadd_executable(${PROJECT_NAME} b.cpp)\n"
        'rclcpp_components_register_node(part PLUGIN "nav::Part" EXECUTABLE part_node)\n',
    )
    file(package / "scripts/tool", mode=0o755)
    (found,) = find(tmp_path)
    assert found.launches == ("a.launch.py", "b_launch.py", "c.launch.xml", "d.launch.yaml")
    assert found.programs == ("driver", "part_node", "look", "blink")


def test_what_a_package_of_ros_1_can_start(tmp_path: Path) -> None:
    """Launch files, executables of C++, and scripts that can be run."""
    package = manifest(tmp_path / "wheel", says=CATKIN)
    file(package / "launch/wheel.launch", "<launch/>")
    file(package / "launch/wheel.launch.py")
    file(package / "nodes/turn", mode=0o755)
    file(package / "nodes/readme.txt")
    file(package / "CMakeLists.txt", "  add_executable (driver\n  a.cpp)\n")
    (found,) = find(tmp_path)
    assert found.launches == ("wheel.launch",)
    assert found.programs == ("driver", "turn")


def test_entry_points_of_setup_cfg(tmp_path: Path) -> None:
    """The other way to write them."""
    package = manifest(tmp_path / "nav")
    file(
        package / "setup.cfg",
        "[options.entry_points]\nconsole_scripts =\n  look = nav.look:main\n[develop]\nscript = a.b:c\n",
    )
    assert find(tmp_path)[0].programs == ("look",)


@pytest.mark.parametrize(
    "text",
    [
        "<package>",
        "",
        "\0",
        "<package><name>a b</name></package>",
        "<robot><name>a</name></robot>",
        "<package/>",
    ],
)
def test_a_manifest_that_cannot_be_read_is_named(tmp_path: Path, text: str) -> None:
    """With a way to go on without it."""
    file(tmp_path / "src/a/package.xml", text)
    with pytest.raises(UsageError, match=r"src/a/package\.xml") as refused:
        find(tmp_path)
    assert "COLCON_IGNORE" in refused.value.cure
