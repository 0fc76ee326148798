from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest
import yaml

from fleet.cli import console
from fleet.ssh import host_keys, known_hosts
from tests.support.boot_partition import BOOKWORM, BULLSEYE, TRIXIE, UBUNTU, UBUNTU_26, boot_partition
from tests.support.project import Project

if TYPE_CHECKING:
    from pathlib import Path

PASSPHRASE = "correct horse"  # noqa: S105  it is the tests' own
INVENTORY = """\
stack: compose.yaml
defaults:
  user: operator
  identity_file: id
  card:
    timezone: Europe/Berlin
    wifi: {country: DE, networks: [{name: Lab, passphrase_from: LAB_WIFI}, {name: Guests, open: true}]}
robots: {pi7: pi7.local, pi8: pi8.local}
"""


@pytest.fixture
def project(tmp_path: Path, desktop: None, monkeypatch: pytest.MonkeyPatch) -> Project:  # noqa: ARG001
    """A folder with two robots, a key to log in with, and a freshly written card."""
    private, public = host_keys.make("me")
    (tmp_path / "id").write_text(private)
    (tmp_path / "id.pub").write_text(public)
    (tmp_path / "inventory.yaml").write_text(INVENTORY)
    monkeypatch.setenv("LAB_WIFI", PASSPHRASE)
    return Project(folder=tmp_path, robots={})


def files(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir()}


def test_a_card_is_prepared_once(project: Project) -> None:
    """A robot with its name, and a host key that is known here; a second run changes nothing."""
    boot = boot_partition(project.folder / "bootfs", TRIXIE)
    done = project.fleet("card", "--hosts", "pi7", "--boot", "bootfs")
    assert done.code == 0, done.err
    assert (
        "Raspberry Pi OS of 2025-11-24, with cloud-init: wrote user-data, network-config, meta-data, cmdline.txt"
        in done.out
    )
    written = files(boot)
    assert written["user-data.before-fleet"] == TRIXIE["user-data"]
    data = yaml.safe_load(written["user-data"])
    assert data["hostname"] == "pi7"
    known = known_hosts.read((project.folder / "known_hosts",))
    assert known.verdict("pi7.local", host_keys.parse(data["ssh_keys"]["ed25519_public"])) == "known"
    assert "`fleet await --hosts pi7` says when the robot has come up" in done.err
    assert PASSPHRASE not in str(written)
    assert "PRIVATE" not in done.out + done.err

    again = project.fleet("card", "--hosts", "pi7", "--boot", "bootfs", "--json")
    assert [one["status"] for one in json.loads(again.out)] == ["unchanged"]
    assert files(boot) == written


def test_a_lost_record_is_written_again(project: Project) -> None:
    """The card has the key."""
    boot_partition(project.folder / "bootfs", TRIXIE)
    project.fleet("card", "--hosts", "pi7", "--boot", "bootfs")
    recorded = (project.folder / "known_hosts").read_text()
    (project.folder / "known_hosts").unlink()
    done = project.fleet("card", "--hosts", "pi7", "--boot", "bootfs")
    assert "with cloud-init: recorded its host key SHA256:" in done.out
    assert (project.folder / "known_hosts").read_text() == recorded


def test_dry_shows_the_files_and_writes_none(project: Project) -> None:
    """Without a secret in them, and without a question for one."""
    boot = boot_partition(project.folder / "bootfs", UBUNTU)
    before = files(boot)
    done = project.fleet("card", "--hosts", "pi7", "--boot", "bootfs", "--dry")
    assert done.code == 0
    assert "pi7: bootfs/network-config" in done.out
    assert "password: (hidden)" in done.out
    assert "ed25519_private: (hidden)" in done.out
    assert "pi7  planned " in done.out
    assert "would write user-data, network-config, meta-data; would record a new host key" in done.out
    assert files(boot) == before
    assert not (project.folder / "known_hosts").exists()


def test_an_older_system_takes_no_host_key(project: Project) -> None:
    """It is said, with what is to be done instead."""
    boot = boot_partition(project.folder / "bootfs", BOOKWORM)
    done = project.fleet("card", "--hosts", "pi7", "--boot", "bootfs")
    assert "with custom.toml: wrote custom.toml" in done.out
    assert "pi7: this system takes one Wi-Fi network, so these are left out: Guests" in done.err
    assert "this system takes no host key: run `fleet trust --hosts pi7`" in done.err
    assert set(files(boot)) - set(BOOKWORM) == {"custom.toml"}


def test_the_oldest_system_takes_a_password(project: Project, monkeypatch: pytest.MonkeyPatch) -> None:
    """From the environment; the second run finds the same hash."""
    boot = boot_partition(project.folder / "bootfs", BULLSEYE)
    words = ("card", "--hosts", "pi7", "--boot", "bootfs")
    asked = project.fleet(*words)
    assert asked.code == 2
    assert "no answer to: Password for the login operator on pi7" in asked.out
    assert "--password-from VARIABLE" in asked.out
    monkeypatch.setenv("LOGIN", "geheim")
    done = project.fleet(*words, "--password-from", "LOGIN")
    assert done.code == 0
    assert files(boot)["userconf.txt"].startswith("operator:$6$")
    assert "this system takes no SSH key" in done.err
    again = project.fleet(*words, "--password-from", "LOGIN")
    assert "unchanged" in again.out


def test_the_card_of_another_robot(project: Project) -> None:
    """Two cards look the same on a desk."""
    boot = boot_partition(project.folder / "bootfs", TRIXIE)
    project.fleet("card", "--hosts", "pi7", "--boot", "bootfs")
    refused = project.fleet("card", "--hosts", "pi8", "--boot", "bootfs")
    assert refused.code == 2
    assert "the card at bootfs was prepared for the robot pi7" in refused.out
    done = project.fleet("card", "--hosts", "pi8", "--boot", "bootfs", "--overwrite")
    assert done.code == 0
    assert yaml.safe_load(files(boot)["user-data"])["hostname"] == "pi8"
    assert files(boot)["user-data.before-fleet"] == TRIXIE["user-data"]


def test_a_card_that_its_robot_has_booted_from(project: Project) -> None:
    """Its host key is only on the robot now: to record another one would make the robot a stranger."""
    boot = boot_partition(project.folder / "bootfs", TRIXIE)
    words = ("card", "--hosts", "pi7", "--boot", "bootfs")
    project.fleet(*words)
    first = files(boot)
    (boot / "user-data").write_text(first["user-data"][: first["user-data"].index("ssh_keys:")])
    booted, recorded = files(boot), (project.folder / "known_hosts").read_text()
    refused = project.fleet(*words)
    assert refused.code == 2
    assert "pi7 has booted from the card at bootfs already" in refused.out
    assert (files(boot), (project.folder / "known_hosts").read_text()) == (booted, recorded)

    assert project.fleet(*words, "--overwrite").code == 0
    anew = files(boot)
    instance = yaml.safe_load(anew["meta-data"])["instance-id"]
    assert instance not in first["meta-data"]
    assert anew["cmdline.txt"] == TRIXIE["cmdline.txt"].replace("rpi-imager", instance)
    assert anew["cmdline.txt.before-fleet"] == TRIXIE["cmdline.txt"]
    assert (project.folder / "known_hosts").read_text() != recorded


def test_the_instance_in_the_folder_of_ubuntu(project: Project) -> None:
    """Since 25.10 the kernel's parameters are there; the Imager writes its own beside, which nobody reads."""
    pinned = UBUNTU["cmdline.txt"].replace("\n", " ds=nocloud;i=rpi-imager-1\n")
    boot = boot_partition(project.folder / "bootfs", UBUNTU_26 | {"current/cmdline.txt": pinned})
    assert project.fleet("card", "--hosts", "pi7", "--boot", "bootfs").code == 0
    instance = yaml.safe_load((boot / "meta-data").read_text())["instance-id"]
    assert (boot / "current/cmdline.txt").read_text() == pinned.replace("rpi-imager-1", instance)
    assert (boot / "current/cmdline.txt.before-fleet").read_text() == pinned


@pytest.mark.parametrize("system", [BOOKWORM, BULLSEYE], ids=["bookworm", "bullseye"])
def test_the_card_of_another_robot_with_an_older_system(
    project: Project, monkeypatch: pytest.MonkeyPatch, system: dict[str, str]
) -> None:
    boot = boot_partition(project.folder / "bootfs", system)
    monkeypatch.setenv("LOGIN", "geheim")
    words = ("--boot", "bootfs", "--password-from", "LOGIN")
    assert project.fleet("card", "--hosts", "pi7", *words).code == 0
    before = files(boot)
    refused = project.fleet("card", "--hosts", "pi8", *words)
    assert (refused.code, files(boot)) == (2, before)
    assert "the card at bootfs was prepared for the robot pi7" in refused.out
    assert project.fleet("card", "--hosts", "pi8", *words, "--overwrite").code == 0


def test_one_card_after_the_other(project: Project, monkeypatch: pytest.MonkeyPatch) -> None:
    """A person changes them; without one there is a sentence, and nothing is written."""
    boot = boot_partition(project.folder / "bootfs", TRIXIE)
    refused = project.fleet("card", "--boot", "bootfs")
    assert refused.code == 2
    assert "2 robots need 2 cards, and nobody is here to change them" in refused.err
    asked = []

    def change(_: console.Screen, text: str) -> bool:
        asked.append(text.split()[4])
        if asked != ["pi7", "pi8"]:  # the first time, somebody forgets to change it
            boot_partition(boot, TRIXIE)
        return True

    monkeypatch.setattr(console.Screen, "interactive", True)
    monkeypatch.setattr(console.Screen, "pause", change)
    done = project.fleet("card", "--boot", "bootfs")
    assert done.code == 0
    assert asked == ["pi7", "pi8", "pi8"]
    assert "pi8: the card at bootfs was prepared for the robot pi7" in done.err
    assert yaml.safe_load(files(boot)["user-data"])["hostname"] == "pi8"


def test_ctrl_c_between_two_cards(project: Project, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was prepared stays, the rest is told as skipped."""
    boot_partition(project.folder / "bootfs", TRIXIE)
    monkeypatch.setattr(console.Screen, "interactive", True)
    monkeypatch.setattr(console.Screen, "pause", lambda _, text: "pi7" in text)
    done = project.fleet("card", "--boot", "bootfs", "--json")
    assert done.code == 1
    assert [one["status"] for one in json.loads(done.out)] == ["done", "skipped"]


@pytest.mark.parametrize(
    ("passphrase", "reason", "cure"),
    [
        ("short", "the passphrase of the Wi-Fi Lab has 5 characters", "Wi-Fi takes 8 to 63 of them"),
        ("", "the variable LAB_WIFI (Lab) is not set", "read -rs LAB_WIFI"),
    ],
)
def test_a_passphrase_that_is_none(
    project: Project, monkeypatch: pytest.MonkeyPatch, passphrase: str, reason: str, cure: str
) -> None:
    boot = boot_partition(project.folder / "bootfs", TRIXIE)
    monkeypatch.setenv("LAB_WIFI", passphrase)
    refused = project.fleet("card", "--hosts", "pi7", "--boot", "bootfs")
    assert refused.code == 2
    assert reason in refused.out
    assert cure in refused.out
    assert files(boot) == TRIXIE


def test_a_passphrase_is_asked_for_once(project: Project, monkeypatch: pytest.MonkeyPatch) -> None:
    """For all cards of a run; it is not in the inventory."""
    questions = []

    def answer(_: console.Screen, question: str) -> str:
        questions.append(question)
        return PASSPHRASE

    (project.folder / "inventory.yaml").write_text(INVENTORY.replace(", passphrase_from: LAB_WIFI", ""))
    boot_partition(project.folder / "bootfs", TRIXIE)
    monkeypatch.setattr(console.Screen, "interactive", True)
    monkeypatch.setattr(console.Screen, "pause", lambda *_: True)
    monkeypatch.setattr(console.Screen, "secret", answer)
    project.fleet("card", "--boot", "bootfs", "--overwrite")
    assert questions == ["Passphrase of the Wi-Fi Lab:"]


@pytest.mark.parametrize(
    ("words", "code", "reason"),
    [
        ((), 2, "which card?"),
        (("--boot", "nothing"), 2, "--boot nothing: no such folder"),
        (("--boot", "."), 2, "is not the boot partition of a Raspberry Pi"),
    ],
)
def test_no_card(project: Project, words: tuple[str, ...], code: int, reason: str) -> None:
    done = project.fleet("card", "--hosts", "pi7", *words)
    assert done.code == code
    assert reason in done.out + done.err


def test_logins_that_cannot_be_made(project: Project) -> None:
    """Root, and one without a key."""
    boot_partition(project.folder / "bootfs", TRIXIE)
    (project.folder / "inventory.yaml").write_text(INVENTORY.replace("operator", "root"))
    assert (
        "fab card makes no login for root" in project.fleet("card", "--hosts", "pi7", "--boot", "bootfs").out
    )
    (project.folder / "inventory.yaml").write_text(INVENTORY.replace("file: id", "file: none"))
    assert (
        "there is no SSH key to log in with"
        in project.fleet("card", "--hosts", "pi7", "--boot", "bootfs").out
    )
