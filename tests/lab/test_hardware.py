from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.support.lab_project import Project, current, service

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.lab.conftest import Pi

JETSON = r"""
printf '# R36 (release), REVISION: 4.0, GCID: 37537400, BOARD: generic, EABI: aarch64\n' > /etc/nv_tegra_release
mkdir -p /etc/cdi
printf '{"cdiVersion": "0.5.0", "kind": "nvidia.com/gpu", "devices": [{"name": "all"}]}' > /etc/cdi/nvidia.json
cd /usr/local/bin
printf '#!/bin/sh\nexit 1\n' > modprobe
printf '#!/bin/sh\necho "# CONFIG_IP_NF_RAW is not set"\n' > zcat
chmod +x modprobe zcat
"""
TOOLKIT = r"""
ln -s "$(command -v runc)" /usr/bin/nvidia-container-runtime
printf '#!/bin/sh\n' > /usr/local/bin/nvidia-ctk
chmod +x /usr/local/bin/nvidia-ctk
"""
DOCKER_28 = r"""
printf '#!/bin/sh\n[ "$1" != version ] || { echo 28.1.0 Engine; exit; }\nexec /usr/bin/docker "$@"\n' > /usr/local/bin/docker
chmod +x /usr/local/bin/docker
"""
RASPBERRY_PI = r"""
mkdir -p /boot/firmware
printf '# of a person\n[all]\ndtparam=audio=on\n' > /boot/firmware/config.txt
printf 'console=serial0,115200 console=tty1 rootwait\n' > /boot/firmware/cmdline.txt
"""
AS_BEFORE = r"""
rm -rf /etc/nv_tegra_release /etc/cdi /usr/bin/nvidia-container-runtime /boot/firmware /run/fleet-reboot /etc/udev/rules.d/99-fleet.rules
rm -f /usr/local/bin/modprobe /usr/local/bin/zcat /usr/local/bin/nvidia-ctk /usr/local/bin/docker /etc/modules-load.d/fleet-i2c.conf
rm -f /dev/lidar
gpasswd --delete pi dialout
[ ! -e /etc/docker/daemon.json.before-fleet ] || mv /etc/docker/daemon.json.before-fleet /etc/docker/daemon.json
systemctl reload docker
"""


@pytest.fixture
def board(pi: Pi) -> Iterator[Pi]:
    """A Pi that may become another board, and is itself again at the end."""
    yield pi
    pi.exec("sh", "-c", AS_BEFORE)


def dry(project: Project, verb: str) -> str:
    """What a verb says that it would do to the first Pi, and to nothing else."""
    return project.fab(verb, "--dry", "--hosts", "pi1").all


def test_a_jetson(project: Project, board: Pi) -> None:
    """Each thing that a release wants and the robot lacks is refused with its cure before a byte is sent."""
    board.exec("sh", "-c", JETSON)
    assert "(L4T 36.4.0)" in project.well("status", "--hosts", "pi1").out
    facts = project.well("inventory", "--facts", "--json", "--hosts", "pi1").json[0]["facts"]["hardware"]
    assert (facts["l4t"], facts["raw_table"], facts["cdi"]) == ("36.4.0", False, ["nvidia.com/gpu=all"])

    project.stack(tick=service(more="devices: [nvidia.com/gpu=all]"))
    assert "CDI is off in the robot's Docker" in dry(project, "ship")
    project.stack(tick=service(more="gpus: all"))
    assert "wants a GPU, and the robot's Docker has no runtime nvidia" in dry(project, "ship")
    project.stack(tick=service(more="runtime: nvidia"))
    refused = dry(project, "ship")
    assert "wants the runtime nvidia, and the robot's Docker has runc" in refused
    assert (
        "cure: `sudo apt-get install nvidia-container-toolkit` on the robot; then `fab provision" in refused
    )

    board.exec("sh", "-c", TOOLKIT)
    started = board.exec("systemctl", "show", "docker", "--property", "ActiveEnterTimestamp")
    project.well("provision", "--hosts", "pi1", "--json")
    assert project.well("provision", "--hosts", "pi1", "--json").status == {"pi1": "unchanged"}
    assert board.exec("systemctl", "show", "docker", "--property", "ActiveEnterTimestamp") == started
    project.well("ship", "--hosts", "pi1")
    container = board.exec("docker", "ps", "--quiet", "--filter", "label=fleet.stack=tiny")
    assert board.exec("docker", "inspect", "--format", "{{.HostConfig.Runtime}}", container) == "nvidia"

    board.exec("sh", "-c", DOCKER_28)
    assert "cure: write `docker: {version: 27.5.1}` for pi1 in the inventory" in dry(project, "provision")
    project.stack(tick=service(more='ports: ["8099:80"]'))
    assert "publishes ports, and Docker 28.1.0 cannot do that here" in dry(project, "ship")


def test_the_hardware_of_a_raspberry_pi(project: Project, board: Pi) -> None:
    """Groups, names and interfaces are set once; a device that is missing stops a ship before anything is touched."""
    board.exec("sh", "-c", RASPBERRY_PI)
    project.well("ship", "--hosts", "pi1")
    before = current(board)
    hardware = {
        "devices": ["/dev/lidar"],
        "udev": {"lidar": {"vendor": "10c4", "product": "ea60"}},
        "interfaces": ["i2c", "serial"],
        "groups": ["dialout"],
    }
    project.inventory(arm={"robots": ["pi1"], "hardware": hardware, "environment": {"COLOUR": "red"}})
    assert "cure: `fab provision --hosts pi1` gives it that name" in project.fab("ship", "--hosts", "pi1").all
    planned = dry(project, "provision")
    for title in (
        "put pi into the groups dialout",
        "name /dev/lidar (udev rules)",
        "switch on i2c, serial, from the next",
    ):
        assert title in planned
    reboot = "reboot it to switch on i2c, serial: `fab run --hosts pi1 -- sudo reboot`"
    assert reboot in project.well("provision", "--hosts", "pi1").out
    again = project.well("provision", "--hosts", "pi1", "--json").json[0]
    assert (again["status"], reboot in again["summary"]) == ("unchanged", True)
    assert "pi1 has to be rebooted to switch on i2c, serial" in project.fab("status", "--hosts", "pi1").err
    assert board.exec("cat", "/boot/firmware/cmdline.txt") == "console=tty1 rootwait"
    assert (
        board.exec("head", "-n", "3", "/boot/firmware/config.txt") == "# of a person\n[all]\ndtparam=audio=on"
    )
    assert "cure: plug it in" in project.fab("ship", "--hosts", "pi1").all
    assert current(board) == before
    board.exec("ln", "-s", "null", "/dev/lidar")
    project.well("ship", "--hosts", "pi1")
    assert current(board) != before
