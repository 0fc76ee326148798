"""Builds a folder of catkin packages for another processor, inside docker/packages.Dockerfile.

needs SOURCES OUT    what the package.xml files depend on: OUT/build and OUT/run, a line for each dependency
names KEYS           the packages of Debian for such a file; apt is set up for the target
build SOURCES OUT    compile against /sysroot and install into OUT; the Debian packages of the libraries: /libraries

Python 3.8 is enough, because a Noetic image has that.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import re
import shutil
import stat
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from catkin_pkg.package import InvalidPackage
from catkin_pkg.packages import find_packages
from catkin_pkg.topological_order import topological_order

if TYPE_CHECKING:
    from catkin_pkg.package import Package

HERE = Path(__file__).resolve().parent
SYSROOT = Path("/sysroot")
PREFIX = Path("/opt/packages")
TRIPLETS = {"armhf": "arm-linux-gnueabihf", "arm64": "aarch64-linux-gnu", "amd64": "x86_64-linux-gnu"}
CONDITIONS = {"ROS_VERSION": "1", "ROS_PYTHON_VERSION": "3", "ROS_DISTRO": "noetic"}

TOOLS = ("roslaunch", "rosmaster", "rosnode", "rosparam", "rostopic")
"""Dependencies of each image: what starts nodes, and what people look around with."""

FAILURES = {
    "--build": "does not compile",
    "--install": "cannot be installed: an install(...) of its CMakeLists.txt fails",
    "-S": "cannot be configured by CMake",
}
"""What it means if CMake fails, by an option that it was called with."""

SHOWN = 8
"""Lines of a compiler's first error that are shown at the end."""


def fail(what: str, *, cure: str = "") -> NoReturn:
    """End with a sentence. On standard output: Docker does not keep the order of two streams."""
    sys.stdout.write(f"{what}. Cure: {cure}\n" if cure else f"{what}\n")
    sys.exit(1)


def folder() -> str:
    """Return the packages' folder as the person knows it."""
    return os.environ.get("PACKAGES", "packages").strip("/")


# --- Which dependencies?


def packages(sources: Path) -> dict[str, Package]:
    """Return the packages of a folder by their paths in it."""
    try:
        found = find_packages(str(sources))
    except (InvalidPackage, RuntimeError) as problem:
        said = " ".join(str(problem).replace(f"{sources}/", f"{folder()}/").split())
        fail(f"{folder()}: a package.xml is wrong: {said.rstrip('.')}", cure="correct it")
    if not found:
        fail(f"{folder()}/ holds no package.xml", cure="put a catkin package there, or set PACKAGES")
    for package in found.values():
        package.evaluate_conditions(CONDITIONS)
    return found


def dependencies(found: dict[str, Package]) -> tuple[dict[str, str], dict[str, str]]:
    """Return what a build and what a run needs from outside, with the package.xml that says so."""
    own = {package.name for package in found.values()}
    build: dict[str, str] = {}
    run = dict.fromkeys(TOOLS, "docker/catkin_packages.py")
    for path, package in sorted(found.items()):
        where = os.path.normpath(f"{folder()}/{path}/package.xml")
        building = (*package.buildtool_depends, *package.buildtool_export_depends)
        building += (*package.build_depends, *package.build_export_depends)
        for depends, into in ((building, build), (package.exec_depends, run)):
            for depend in depends:
                if depend.evaluated_condition and depend.name not in own:
                    into.setdefault(depend.name, where)
    return build, run


def needs(sources: Path, out: Path) -> None:
    """Write what the packages depend on."""
    out.mkdir(parents=True)
    build, run = dependencies(packages(sources))
    for name, keys in (("build", build), ("run", run)):
        (out / name).write_text("".join(f"{key}\t{where}\n" for key, where in sorted(keys.items())))


# --- What does Debian call them?


def candidates(key: str, *, table: dict[str, list[str]], distribution: str = "") -> list[str]:
    """Return names of packages that a dependency may have; ``distribution`` of an image of the ROS project."""
    if key in table:
        return table[key]
    dashed = key.lower().replace("_", "-")
    ours = [f"ros-{distribution}-{dashed}"] if distribution else []
    ours += [f"lib{dashed}-dev", f"{dashed}-dev", f"python3-{dashed}", f"ros-{dashed}", f"{dashed}-tools"]
    return [*ours, dashed]


def for_run(name: str, depends: list[str]) -> list[str]:
    """Return what a run needs of a package: all of it, or the libraries of a package that is for the build."""
    if not name.endswith("-dev"):
        return [name]
    return [one for one in depends if re.match(r"lib.*\d[a-z0-9.]*$", one)]


def chosen(
    keys: dict[str, str],
    known: dict[str, list[str]],
    *,
    table: dict[str, list[str]],
    run: bool,
    distribution: str = "",
) -> list[str]:
    """Return the packages for dependencies; ``known`` has what each package depends on."""
    found: set[str] = set()
    for key, where in keys.items():
        names = [one for one in candidates(key, table=table, distribution=distribution) if one in known]
        if not names:
            more = f"correct its name, or write into docker/rosdep.yaml: {key}: {{debian: [PACKAGE]}}"
            fail(f"{where}: no package is known for the dependency {key}", cure=more)
        found.update(part for name in names for part in (for_run(name, known[name]) if run else [name]))
    return sorted(found)


def apt_knows(names: set[str]) -> dict[str, list[str]]:
    """Return those names that apt has a package for, and what each depends on."""
    command = ("apt-cache", "show", "--no-all-versions", *sorted(names))
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, check=False)
    known: dict[str, list[str]] = {}
    for record in done.stdout.split("\n\n"):
        fields = dict(re.findall(r"^(Package|Depends): (.*)$", record, re.MULTILINE))
        if "Package" in fields:
            known[fields["Package"]] = re.findall(r"(?:^|, )([^ ,|:]+)", fields.get("Depends", ""))
    return known


def names(file: Path) -> None:
    """Print the packages for a file that `needs` wrote."""
    import yaml  # noqa: PLC0415 - only this command needs it

    try:
        text = (HERE / "rosdep.yaml").read_text(encoding="utf-8")
        table = {key: [str(name) for name in value["debian"]] for key, value in yaml.safe_load(text).items()}
    except (yaml.YAMLError, AttributeError, TypeError, LookupError) as problem:
        said = " ".join(str(problem).split())
        fail(f"docker/rosdep.yaml cannot be read: {said}", cure="each line is KEY: {debian: [PACKAGE]}")
    distribution = next((path.name for path in sorted(Path("/opt/ros").glob("*"))), "")
    keys = dict(line.split("\t") for line in file.read_text().splitlines())
    asked = {one for key in keys for one in candidates(key, table=table, distribution=distribution)}
    picked = chosen(keys, apt_knows(asked), table=table, run=file.name == "run", distribution=distribution)
    sys.stdout.write("\n".join(picked))


# --- Compile


def copy_changed(source: Path, target: Path) -> None:
    """Make ``target`` like ``source``. A file that has the same bytes keeps its time, so make does not see a change."""
    for old in sorted(target.rglob("*"), reverse=True):
        new = source / old.relative_to(target)
        if old.is_dir() and not old.is_symlink():
            if not new.is_dir() or new.is_symlink():
                old.rmdir()
        elif new.is_symlink() or not new.is_file() or _differ(old, new):
            old.unlink()
    for new in sorted(source.rglob("*")):
        old = target / new.relative_to(source)
        if new.is_symlink():
            old.symlink_to(os.readlink(str(new)))  # noqa: PTH115 - Python 3.8
        elif new.is_dir():
            old.mkdir(parents=True, exist_ok=True)
        elif not old.exists():
            old.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(str(new), str(old))
            old.chmod(new.stat().st_mode)


def _differ(one: Path, other: Path) -> bool:
    mode = one.is_symlink() or one.stat().st_mode != other.stat().st_mode
    return mode or one.read_bytes() != other.read_bytes()


def digest(top: Path) -> str:
    """Return a digest of the files of a folder: names, modes and bytes."""
    found = hashlib.sha256()
    for path in sorted(top.rglob("*")):
        if path.is_symlink():
            content = os.readlink(str(path)).encode()  # noqa: PTH115 - Python 3.8
        elif path.is_file():
            content = path.read_bytes()
        else:
            continue
        head = f"{path.relative_to(top)}\0{path.lstat().st_mode:o}\0{len(content)}\0"
        found.update(head.encode() + content)
    return found.hexdigest()


def toolchain(triplet: str) -> str:
    """Return a digest of all that is compiled with and against: another one begins with empty folders."""
    version = subprocess.run((f"{triplet}-g++", "-v"), stderr=subprocess.PIPE, text=True, check=True).stderr
    own = (HERE / "toolchain.cmake").read_text() + Path(__file__).read_text(encoding="utf-8")
    return hashlib.sha256(f"{version}{own}{headers(SYSROOT)}".encode()).hexdigest()


def headers(sysroot: Path) -> str:
    """Return a digest of what may be in a sysroot: the packages of its base, those unpacked over it, and other files.

    A ROS that its image has compiled is in no list of packages: the names, sizes and times of its files count.
    """
    dpkg = sysroot / "var/lib/dpkg"
    found = hashlib.sha256(f"{_read(dpkg / 'status')}{digest(dpkg / 'status.d')}".encode())
    for top in ("opt", "usr/local"):
        for path in sorted((sysroot / top).rglob("*")):
            about = path.lstat()
            if not stat.S_ISDIR(about.st_mode):
                found.update(
                    f"{path.relative_to(sysroot)}\0{about.st_size}\0{int(about.st_mtime)}\0".encode()
                )
    return found.hexdigest()


def compiled_with(package: Package, own: dict[str, Package]) -> set[str]:
    """Return the packages of the folder whose files a package is compiled with: those it needs, and what they export."""
    found: set[str] = set()
    left = [*package.build_depends, *package.buildtool_depends]
    while left:
        depend = left.pop()
        if depend.evaluated_condition and depend.name in own and depend.name not in found:
            found.add(depend.name)
            left += own[depend.name].build_export_depends + own[depend.name].buildtool_export_depends
    return found


class Builder:
    """Builds packages for a target, with what the cache has of them."""

    def __init__(self, own: dict[str, Package], *, triplet: str, cache: Path) -> None:
        self._own, self._cache = own, cache
        self._made = toolchain(triplet)
        self._digests: dict[str, str] = {}
        python = ":".join(str(path) for path in sorted(SYSROOT.glob("**/python3/dist-packages")))
        self._environment = {**os.environ, "TRIPLET": triplet, "PYTHONPATH": python}

    def build(self, source: Path, package: Package) -> None:
        """Compile a package, if it or what it needs has changed, and install it."""
        place = self._cache / package.name
        place.mkdir(parents=True, exist_ok=True)
        with (place / "lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            self._build(source, package, place)

    def _build(self, source: Path, package: Package, place: Path) -> None:
        below = [self._digests[name] for name in sorted(compiled_with(package, self._own))]
        is_now = hashlib.sha256(" ".join((self._made, digest(source), *below)).encode()).hexdigest()
        self._digests[package.name] = is_now
        stamp, made = place / "stamp", place / "toolchain"
        if _read(made) != self._made:
            for name in ("source", "build"):
                shutil.rmtree(str(place / name), ignore_errors=True)
            made.write_text(self._made)
        if _read(stamp) == is_now:
            sys.stdout.write(f"{package.name}: unchanged\n")
        else:
            if stamp.exists():
                stamp.unlink()
            sys.stdout.write(f"{package.name}: compiling\n")
            sys.stdout.flush()
            (place / "source").mkdir(exist_ok=True)
            copy_changed(source, place / "source")
            self._compile(package.name, place)
            stamp.write_text(is_now)
        self._run(package.name, place, "cmake", "--install", str(place / "build"), "--strip")

    def _compile(self, name: str, place: Path) -> None:
        settings = {
            "CMAKE_TOOLCHAIN_FILE": HERE / "toolchain.cmake",
            "CMAKE_BUILD_TYPE": "Release",
            "CMAKE_INSTALL_PREFIX": PREFIX,
            "CMAKE_PREFIX_PATH": ";".join([str(PREFIX), *map(str, Path("/opt/ros").glob("*")), "/usr"]),
            "CATKIN_ENABLE_TESTING": "OFF",
        }
        flags = [f"-D{key}={value}" for key, value in settings.items()]
        self._run(name, place, "cmake", "-S", str(place / "source"), "-B", str(place / "build"), *flags)
        jobs = str(os.cpu_count() or 1)
        self._run(name, place, "cmake", "--build", str(place / "build"), "--parallel", jobs)

    def _run(self, name: str, place: Path, *command: str) -> None:
        """Run a command and show its output. If it fails, its first error comes again, at the end."""
        done = subprocess.run(
            command,
            cwd=str(place),  # CMake shortens paths by it
            env=self._environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            check=False,
        )
        output = done.stdout.replace(f"{place}/source/", f"{name}/").replace(f"{place}/build/", "")
        sys.stdout.write(output)
        sys.stdout.flush()
        if done.returncode:
            what = next(what for option, what in FAILURES.items() if option in command)
            # Empty lines, because `fab build` shows the last 12 of a step: the error, and nothing of what make says.
            sys.stdout.write("\n" * 12)
            fail("\n".join((f"{name} {what}:", *first_error(output))))


def _read(path: Path) -> str:
    return path.read_text() if path.exists() else ""


def first_error(output: str) -> list[str]:
    """Return the lines from the first error of a compiler, a linker or CMake on, without what make says about it."""
    lines = [line.rstrip() for line in output.splitlines() if line.strip()]
    lines = [
        line
        for line in lines
        if not re.match(r"g?make(\[\d+\])?: |\[ *\d+%\]|-- |In file included from", line)
    ]
    sign = re.compile(r"\berror\b|CMake Error|undefined reference|No rule to make", re.IGNORECASE)
    first = next(
        (number for number, line in enumerate(lines) if sign.search(line)), max(0, len(lines) - SHOWN)
    )
    missing = re.search(r'package configuration file provided by "(\w+)"', "\n".join(lines))
    if missing:
        return [*lines[first : first + 2], f"Cure: <depend>{missing[1]}</depend> in package.xml"]
    return lines[first : first + SHOWN]


# --- Which libraries?


def elf_files(top: Path) -> list[Path]:
    """Return the programs and libraries in a folder."""
    files = [path for path in sorted(top.rglob("*")) if path.is_file() and not path.is_symlink()]
    return [path for path in files if path.open("rb").read(4) == b"\x7fELF"]


def owners(needed: dict[str, str], unpacked: Path) -> tuple[set[str], set[str]]:
    """Return the packages that brought libraries, and the libraries that no package brought."""
    found: set[str] = set()
    left = {*needed}
    for file in sorted(unpacked.iterdir()):
        brought = {line.rpartition("/")[2] for line in file.read_text().splitlines()} & {*needed}
        if brought and not file.name.endswith("-dev"):
            found.add(file.name)
            left -= brought
    return found, left


def libraries(top: Path, triplet: str) -> set[str]:
    """Return the Debian packages of the libraries that the programs in a folder need."""
    files = elf_files(top)
    needed: dict[str, str] = {}
    for path in files:
        command = (f"{triplet}-readelf", "--dynamic", "--wide", str(path))
        said = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout
        for name in re.findall(r"\(NEEDED\).*\[(.+)\]", said):
            needed.setdefault(name, path.name)
    for own in (path.name for path in top.rglob("*.so*")):
        needed.pop(own, None)
    found, left = owners(needed, SYSROOT / "unpacked")
    places = [
        SYSROOT / "lib",
        SYSROOT / "usr/lib",
        *SYSROOT.glob(f"*/lib/{triplet}"),
        SYSROOT / f"lib/{triplet}",
    ]
    places += SYSROOT.glob("opt/ros/*/lib")
    for name in sorted(left):
        if not any((place / name).exists() for place in places):
            cure = "name the package that brings it in package.xml"
            fail(f"{needed[name]} needs {name}, which will not be on the robot", cure=cure)
    return found


def ordered(sources: Path) -> list[tuple[str | None, Package]]:
    """Return the packages by their paths, in the order of their dependencies.

    catkin_pkg takes the variables of conditions from the environment. The nodes' own CMake must not see them.
    """
    before = dict(os.environ)
    os.environ.update(CONDITIONS)
    try:
        found: list[tuple[str | None, Package]] = topological_order(str(sources))
    finally:
        os.environ.clear()
        os.environ.update(before)
    return found


def build(sources: Path, out: Path) -> None:
    """Build the packages in the order of their dependencies."""
    architecture = Path("/architecture").read_text().strip()
    triplet = TRIPLETS[architecture]
    link_paths(triplet)
    order = ordered(sources)
    if order and order[-1][0] is None:
        fail(f"{folder()}: packages depend on each other in a circle: {order[-1][1]}")
    found = packages(sources)
    own = {package.name: package for package in found.values()}
    cache = Path("/cache") / os.environ.get("CACHE", "packages") / architecture
    builder = Builder(own, triplet=triplet, cache=cache)
    for path, package in order:
        builder.build(sources / path, own[package.name])
    Path("/libraries").write_text("".join(f"{name}\n" for name in sorted(libraries(PREFIX, triplet))))
    shutil.copytree(str(PREFIX.resolve()), str(out / PREFIX.relative_to("/")), symlinks=True)


def link_paths(triplet: str) -> None:
    """Make absolute paths lead into the sysroot: catkin's configurations have them, and tell CMake not to map them."""
    (SYSROOT / PREFIX.relative_to("/")).mkdir(parents=True, exist_ok=True)
    targets = [
        SYSROOT / path.relative_to("/")
        for path in (PREFIX, Path("/opt/ros"), Path("/etc/ros"), Path("/usr/lib") / triplet)
    ]
    targets += [*SYSROOT.glob("usr/share/*"), *SYSROOT.glob("usr/lib/*")]
    for target in targets:
        path = Path("/") / target.relative_to(SYSROOT)
        if target.exists() and not path.exists() and not path.is_symlink():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.symlink_to(target)


def main() -> None:
    """Do what the first argument says."""
    command, *paths = sys.argv[1:]
    {"needs": needs, "names": names, "build": build}[command](*map(Path, paths))


if __name__ == "__main__":
    main()
