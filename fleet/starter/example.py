"""Where are the files of the example, and which are they? Those of fleet's repository, as they are.

The wheel has a copy of them beside this module; a checkout has them where they are edited.
"""

from __future__ import annotations

import os
from pathlib import Path

PARTS = (
    *(".dockerignore", "inventory.yaml", "inventory.schema.json"),
    *("docker/Dockerfile", "docker/compose.yaml", "docker/cross-install.sh"),
    *("fabfile.py", "fabric.yaml"),  # its inventory says `fab`, and so a person may
    *("docker/entrypoint.sh", "docker/python_logging.yaml", "docker/roslaunch.py", "docker/ros2"),
    *("docker/packages.yaml", "docker/packages.Dockerfile", "docker/packages.Dockerfile.dockerignore"),
    *("docker/build-tools.sh", "docker/catkin_packages.py", "docker/rosdep.yaml", "docker/toolchain.cmake"),
    *("talker", "packages"),
)
"""Files and folders of the repository that are only the example's; ``pyproject.toml`` packs the same ones into the wheel."""

SHARED = ("fleet/ros/tcpros.py", "fleet/ros/ros2_check.py")
"""Files of the program that the example builds into its image; the wheel has them at the same place as a checkout."""

_IN_THE_WHEEL = Path(__file__).parent / "example"


def files(*, installed: Path = _IN_THE_WHEEL) -> dict[str, Path]:
    """Return the path of each file of the example by its name in a project."""
    program = Path(__file__).parents[2]
    top = installed if installed.is_dir() else program
    found = {part: program / part for part in SHARED}
    for part in PARTS:
        path = top / part
        inside = sorted(_walk(path)) if path.is_dir() else [path]
        found |= {one.relative_to(top).as_posix(): one for one in inside}
    return found


def _walk(folder: Path) -> list[Path]:
    """The files below a folder. Installers compile Python files; what they make is not a part of the example."""
    found: list[Path] = []
    for place, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if name != "__pycache__"]
        found += [Path(place) / name for name in names]
    return found
