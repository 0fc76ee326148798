from __future__ import annotations

import io
import re
import tarfile

from fleet import onboard
from fleet.bundle import make
from fleet.config.compose import HOME
from tests.support.bundles import BLOBS, bundle
from tests.support.samples import PI, release, stack


def test_layers_and_images_are_there_once_for_all_robots() -> None:
    """Releases are the robots' own."""
    whole, pieces = bundle("pi1", "pi2", "pi3")
    names = [one.path for one in pieces]
    assert sorted(name for name in names if name.startswith("layers/")) == sorted(
        f"layers/{x}.01" for x in BLOBS
    )
    assert sum(name.startswith("images/") for name in names) == 1
    assert sum(name.startswith("releases/") for name in names) == len(whole.robots) == 3


def test_names_fit_on_a_stick() -> None:
    """FAT32 knows no upper and lower case, and no `:`, `?` and `*`; robots' names are only in the index."""
    _, pieces = bundle("pi1", "PI1", "Pi1")
    names = {one.path for one in pieces}
    assert len({name.lower() for name in names}) == len(names)
    assert all(re.fullmatch(r"[a-zA-Z0-9._/-]+", name) for name in names)


def test_the_home_of_the_login_is_left_open() -> None:
    """The robot puts it in: `install` has the same placeholder."""
    _, pieces = bundle("pi1")
    (release,) = (one for one in pieces if one.path.startswith("releases/"))
    with tarfile.open(fileobj=io.BytesIO(release.open().read())) as archive:
        text = archive.extractfile("compose.yaml")
        assert text
        assert HOME.encode() in text.read()
    assert f"s|{HOME}|$HOME|g" in onboard.text("install.sh")


def test_what_a_release_wants_of_the_robot_is_in_the_index() -> None:
    """Devices of the inventory and the Compose file, ports of all addresses, container names; each once."""
    service = {
        "image": "talker",
        "container_name": "cam",
        "devices": ["/dev/video0", {"source": "/dev/ttyUSB0", "target": "/dev/tty"}, "nvidia.com/gpu=all"],
        "ports": [
            {"target": 80, "published": "8080", "protocol": "tcp"},
            {"target": 81, "published": "9000-9001", "protocol": "udp"},
            {"target": 82, "published": "8082", "host_ip": "127.0.0.1"},
        ],
    }
    robot = PI.model_copy(
        update={"hardware": PI.hardware.model_copy(update={"devices": ("/dev/imu", "/dev/video0")})}
    )
    found = make._wants(robot, release(of=stack(cam=service, talker={"image": "talker"})))  # noqa: SLF001
    assert found == (
        ("device", "/dev/imu"),
        ("device", "/dev/video0"),
        ("device", "/dev/ttyUSB0"),
        ("port", "8080/tcp"),
        ("port", "9000/udp"),
        ("port", "9001/udp"),
        ("name", "cam"),
    )


def test_the_stick_has_the_scripts_that_its_program_runs() -> None:
    """Those of `fab ship`, whole."""
    _, pieces = bundle("pi1")
    there = {
        one.path.partition("/")[2]: one.open().read() for one in pieces if one.path.startswith("programs-")
    }
    assert there == {name: onboard.text(name).encode() for name in make.PROGRAMS}
    used = set(re.findall(r"\$\(program ([a-z_]+)\)", onboard.text("install.sh")))
    assert {f"{name}.sh" for name in used} == set(make.PROGRAMS)
