from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from fleet.card import cloud_init, custom_toml, prepared, userconf, write
from fleet.card.prepared import Prepared
from fleet.errors import UsageError
from tests.support.first_boots import FIRST

if TYPE_CHECKING:
    from pathlib import Path

SYSTEMS = {
    "cloud-init": cloud_init.files(FIRST, raspberry_pi_os=True, cmdlines={}),
    "bookworm": custom_toml.files(FIRST),
    "bullseye": userconf.files(FIRST),
    "bullseye without Wi-Fi": userconf.files(replace(FIRST, networks=())),
}


@pytest.mark.parametrize("system", SYSTEMS)
def test_whose_card_it_is(tmp_path: Path, system: str) -> None:
    """Whichever system is on it, two cards look the same on a desk."""
    write.write(SYSTEMS[system], folder=tmp_path)
    there = prepared.look(tmp_path)
    assert (there.robot, there.booted) == ("pi7", False)
    there.check("pi7")
    with pytest.raises(UsageError, match="was prepared for the robot pi7"):
        there.check("pi8")


def test_a_second_run_finds_the_host_key(tmp_path: Path) -> None:
    write.write(SYSTEMS["cloud-init"], folder=tmp_path)
    assert prepared.look(tmp_path).host_key == FIRST.host_key


def test_a_card_that_its_robot_has_booted_from(tmp_path: Path) -> None:
    """The first boot has cut the host key off: a new one would be recorded here, and the robot would keep its own."""
    text = SYSTEMS["cloud-init"]["user-data"]
    (tmp_path / "user-data").write_text(text[: text.index("ssh_keys:")])
    there = prepared.look(tmp_path)
    assert there == Prepared(folder=tmp_path, robot="pi7", booted=True)
    with pytest.raises(UsageError, match="pi7 has booted from the card") as refused:
        there.check("pi7")
    assert "--overwrite" in refused.value.cure
    with pytest.raises(UsageError, match="was prepared for the robot pi7"):
        there.check("pi8")


def test_a_card_that_was_not_prepared(tmp_path: Path) -> None:
    """What the image has is nobody's."""
    (tmp_path / "user-data").write_text("#cloud-config\n# hostname: raspberrypi\n")
    prepared.look(tmp_path).check("pi7")
    assert prepared.look(tmp_path) == Prepared(folder=tmp_path)
