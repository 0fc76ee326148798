from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml

from fleet.card import cloud_init
from tests.support.first_boots import FIRST, KEY

if TYPE_CHECKING:
    from fleet.card.first_boot import FirstBoot

HERE = Path("user-data")


def user_data(first: FirstBoot = FIRST, *, raspberry_pi_os: bool = True) -> dict[str, Any]:
    text = cloud_init.files(first, raspberry_pi_os=raspberry_pi_os, cmdlines={})["user-data"]
    assert text.startswith("#cloud-config\n")
    found: dict[str, Any] = yaml.safe_load(text)
    return found


def test_a_robot_has_its_name_its_login_and_its_host_key() -> None:
    """Only keys log in, and nobody logs in as root."""
    data = user_data()
    assert (data["hostname"], data["timezone"]) == ("pi7", "Europe/Berlin")
    assert (data["ssh_pwauth"], data["disable_root"], data["ssh_deletekeys"]) == (False, True, True)
    assert FIRST.host_key
    assert data["ssh_keys"] == {
        "ed25519_private": FIRST.host_key.private,
        "ed25519_public": FIRST.host_key.public,
    }
    (login,) = data["users"]
    assert (login["name"], login["primary_group"], login["lock_passwd"]) == ("pi", "pi", True)
    assert login["ssh_authorized_keys"] == list(FIRST.keys)


def test_the_private_key_is_last_so_that_it_can_be_cut_off() -> None:
    """What the robot does when its first boot is over leaves the rest of the file as it was."""
    lines = cloud_init.files(FIRST, raspberry_pi_os=True, cmdlines={})["user-data"].splitlines()
    tail = lines[lines.index("ssh_keys:") + 1 :]
    assert all(line.startswith(" ") for line in tail)


def test_raspberry_pi_os_keeps_the_key_and_switches_ssh_on() -> None:
    """It would make new keys after cloud-init; other systems have neither the service nor a switch."""
    raspberry, ubuntu = user_data(), user_data(raspberry_pi_os=False)
    assert "regenerate_ssh_host_keys" in str(raspberry["bootcmd"])
    assert ["systemctl", "enable", "--now", "ssh"] in raspberry["runcmd"]
    assert "bootcmd" not in ubuntu
    assert "systemctl" not in str(ubuntu["runcmd"])


def test_a_name_in_the_local_network_needs_avahi_on_ubuntu() -> None:
    """Raspberry Pi OS has it."""
    assert user_data(replace(FIRST, announces=True), raspberry_pi_os=False)["packages"] == ["avahi-daemon"]
    assert "packages" not in user_data(raspberry_pi_os=False)
    assert "packages" not in user_data(replace(FIRST, announces=True))


def test_wifi_and_cable() -> None:
    """Any name of a network survives YAML; an open one has no password."""
    text = cloud_init.files(FIRST, raspberry_pi_os=True, cmdlines={})["network-config"]
    network = yaml.safe_load(text)["network"]
    assert network["wifis"]["wlan0"] == {
        "dhcp4": True,
        "regulatory-domain": "DE",
        "access-points": {'Lab: "5 GHz" ß': {"password": KEY}, "Guests": {"hidden": True}},
    }
    assert network["ethernets"]["cable"]["optional"] is True
    cable = cloud_init.files(replace(FIRST, networks=()), raspberry_pi_os=True, cmdlines={})["network-config"]
    assert "wifis" not in yaml.safe_load(cable)["network"]


def test_other_content_is_another_instance() -> None:
    """cloud-init sets a computer up once for each; the same content is the same one."""
    same = {cloud_init.files(FIRST, raspberry_pi_os=True, cmdlines={})["meta-data"] for _ in range(2)}
    other = cloud_init.files(replace(FIRST, timezone="UTC"), raspberry_pi_os=True, cmdlines={})["meta-data"]
    assert len(same) == 1
    assert other not in same
    assert yaml.safe_load(other)["instance-id"].startswith("fleet-pi7-")


REST = "console=serial0,115200 snd_bcm2835.enable_hdmi=1 root=PARTUUID=6b6bd2ba-02 rootwait"


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("ds=nocloud;i=rpi-imager-1781294579815", "ds=nocloud;i={}"),
        ("ds=nocloud;s=/boot/firmware/;i=rpi-imager-1 quiet", "ds=nocloud;s=/boot/firmware/;i={} quiet"),
        ("ds=nocloud;instance-id=a;h=b", "ds=nocloud;instance-id={};h=b"),
    ],
)
def test_the_kernels_parameter_names_our_instance(before: str, after: str) -> None:
    """It goes before meta-data: with the old one, a system that has booted would not read our files. All else stays."""
    files = cloud_init.files(
        FIRST, raspberry_pi_os=True, cmdlines={"cmdline.txt": f"{REST} {before}\n", "none": ""}
    )
    instance = yaml.safe_load(files["meta-data"])["instance-id"]
    assert files["cmdline.txt"] == f"{REST} {after.format(instance)}\n"
    again = cloud_init.files(FIRST, raspberry_pi_os=True, cmdlines={"cmdline.txt": files["cmdline.txt"]})
    assert again == files


@pytest.mark.parametrize("cmdline", ["", REST, f"{REST} ds=nocloud", f"{REST} xds=nocloud;i=a"])
def test_without_that_parameter_the_kernels_line_stays(cmdline: str) -> None:
    """Then meta-data counts."""
    assert "cmdline.txt" not in cloud_init.files(
        FIRST, raspberry_pi_os=True, cmdlines={"cmdline.txt": cmdline}
    )


def test_what_a_card_has_already_is_read_back() -> None:
    """The host key: so a second run changes nothing."""
    text = cloud_init.files(FIRST, raspberry_pi_os=True, cmdlines={})["user-data"]
    assert cloud_init.host_key(text, path=HERE) == FIRST.host_key


@pytest.mark.parametrize("text", ["", "#cloud-config\n", "#cloud-config\nssh_keys: none\n", "a: [", "- 1\n"])
def test_a_card_of_somebody_else_has_none(text: str) -> None:
    assert cloud_init.host_key(text, path=HERE) is None
