import itertools
from pathlib import Path

import pytest

from fleet.errors import DesktopError
from fleet.lab.virtual_pi import VirtualPi, image_tag, run_command

PI = VirtualPi(name="pi2", lab="bench", address="172.30.0.12", platform="linux/arm64")


def command() -> tuple[str, ...]:
    return run_command(PI, image="pi:1", network="fleet-bench", labels=("fleet.lab=bench",))


def test_a_pi_has_its_own_name_address_and_disk() -> None:
    """What makes one Pi differ from the next, in Docker's words."""
    pairs = set(itertools.pairwise(command()))
    assert {
        ("--name", "bench-pi2"),
        ("--hostname", "pi2"),
        ("--network-alias", "pi2"),
        ("--network", "fleet-bench"),
        ("--ip", "172.30.0.12"),
        ("--volume", "bench-pi2-docker:/var/lib/docker"),
        ("--label", "fleet.lab=bench"),
    } <= pairs


def test_a_pi_may_not_do_what_would_change_the_desktop() -> None:
    """No privileged container, no clock, no modules, no devices, no view of the desktop's control groups."""
    said = " ".join(command())
    assert not [
        word for word in ("--privileged", "SYS_TIME", "SYS_MODULE", "--device", "/sys/fs") if word in said
    ]
    assert ("--cgroupns", "private") in set(itertools.pairwise(command()))


def test_the_image_is_the_last_word() -> None:
    """Anything after it would be a command in place of the boot."""
    assert command()[-1] == "pi:1"


@pytest.fixture
def recipe(tmp_path: Path) -> Path:
    """A recipe with the two files that matter here."""
    (tmp_path / "Dockerfile").write_text("FROM scratch\n")
    (tmp_path / "get-docker.sh").write_text("true\n")
    return tmp_path


def test_another_recipe_is_another_image(recipe: Path) -> None:
    """A change is built without anybody thinking of it, and the same recipe is not built twice."""
    first = image_tag(recipe)
    assert image_tag(recipe) == first
    (recipe / "lab-extra.service").write_text("[Unit]\n")
    assert image_tag(recipe) != first


def test_another_debian_is_another_image(recipe: Path) -> None:
    """Trixie's is what nobody has to ask for."""
    assert image_tag(recipe, suite="trixie") == image_tag(recipe)
    assert image_tag(recipe, suite="bookworm") != image_tag(recipe)


def test_the_convenience_script_is_no_part_of_the_image(recipe: Path) -> None:
    """It reaches a Pi with `provision`; a change of it does not rebuild anything."""
    first = image_tag(recipe)
    (recipe / "get-docker.sh").write_text("false\n")
    assert image_tag(recipe) == first


def test_a_recipe_that_is_not_there_is_said(tmp_path: Path) -> None:
    """It is a part of the installed package."""
    with pytest.raises(DesktopError, match="install fleet again"):
        image_tag(tmp_path)
