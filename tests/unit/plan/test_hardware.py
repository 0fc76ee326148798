from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from fleet.config.hardware import Hardware, Usb
from fleet.errors import NotReady
from fleet.plan import hardware
from tests.support.samples import PI, TALKER, facts, release, stack

ORIN: dict[str, Any] = {
    "model": "NVIDIA Jetson Orin Nano",
    "l4t": "36.4.0",
    "runtimes": ("io.containerd.runc.v2", "runc"),
}
ALL = ("/dev/null", "/dev/ttyACM0", "/dev/serial/by-id/usb-Arduino-if00", "/dev/bus/usb/001/002")
GPU = "nvidia.com/gpu=all"
CDI: list[dict[str, str]] = [{"source": GPU, "target": GPU, "permissions": "rwm"}]
RESERVED = {"resources": {"reservations": {"devices": [{"capabilities": ["gpu"], "count": -1}]}}}


def check(
    service: dict[str, Any],
    *,
    of: Hardware | None = None,
    made_for: str = "",
    **seen: Any,  # noqa: ANN401  facts
) -> None:
    robot = PI.model_copy(update={"hardware": of or Hardware()})
    image = replace(TALKER, l4t=made_for)
    shipped = release(robot=robot, of=stack(node={"image": "talker", **service}), image=image)
    hardware.check(robot, shipped, facts(**seen))


def refused(service: dict[str, Any], **more: Any) -> tuple[str, str]:  # noqa: ANN401  as `check` takes them
    with pytest.raises(NotReady) as problem:
        check(service, **more)
    return problem.value.what, problem.value.cure


@pytest.mark.parametrize(
    ("service", "seen"),
    [
        ({}, {}),
        ({"runtime": "nvidia"}, {"runtimes": ("runc", "nvidia")}),
        ({"runtime": "nvidia"}, {}),  # it is not known what Docker has
        ({"runtime": "io.containerd.runc.v2"}, {"runtimes": ("runc",)}),
        ({"gpus": [{"count": -1}]}, {"runtimes": ("runc", "nvidia")}),
        ({"gpus": [{"count": -1}]}, {"runtimes": ("runc",), "docker_cdi": True, "hardware_cdi": (GPU,)}),
        ({"gpus": [{"driver": "amd"}]}, {"runtimes": ("runc",)}),
        ({"devices": CDI}, {"docker_cdi": True, "hardware_cdi": (GPU,)}),
        ({"devices": ["/dev/ttyACM0:/dev/arm:rwm"]}, {"devices": ALL}),
        ({"devices": ["/dev/ttyUSB0"]}, {"devices": ()}),  # the probe of an older fleet
        ({"l4t": "35.4.1"}, {}),
        ({"l4t": "36.2.0"}, ORIN),
        ({"ports": [{"target": 80, "published": "80"}]}, {"docker_version": "27.5.1", "raw_table": False}),
        (
            {"ports": [{"target": 80, "published": "80"}], "network_mode": "host"},
            {"docker_version": "28.1.0", "raw_table": False},
        ),
        ({"ports": [{"target": 80, "published": "80"}]}, {"docker_version": "28.1.0", "raw_table": True}),
    ],
)
def test_a_robot_that_has_it(service: dict[str, Any], seen: dict[str, Any]) -> None:
    """Nothing is refused that could run."""
    check(
        {key: value for key, value in service.items() if key != "l4t"},
        made_for=service.get("l4t", ""),
        **seen,
    )


APT = "`sudo apt-get install nvidia-container-toolkit` on the robot; then "
PROVISION = "`fab provision --hosts pi1` tells Docker of the runtime"
OTHER = (
    "use a robot with an NVIDIA GPU and the NVIDIA Container Toolkit, or another Compose file for this one"
)


@pytest.mark.parametrize(
    ("service", "seen", "what", "cure"),
    [
        (
            {"runtime": "nvidia"},
            ORIN,
            "service node wants the runtime nvidia, and the robot's Docker has runc",
            APT + PROVISION,
        ),
        (
            {"runtime": "nvidia"},
            {**ORIN, "toolkit": True},
            "service node wants the runtime nvidia, and the robot's Docker has runc",
            PROVISION,
        ),
        (
            {"runtime": "nvidia"},
            {"runtimes": ("runc",)},
            "service node wants the runtime nvidia, and the robot's Docker has runc",
            OTHER,
        ),
        (
            {"runtime": "crun"},
            {"runtimes": ("runc",)},
            "service node wants the runtime crun, and the robot's Docker has runc",
            "remove `runtime:` of node",
        ),
        *(
            (
                gpu,
                ORIN,
                "service node wants a GPU, and the robot's Docker has no runtime nvidia",
                APT + PROVISION,
            )
            for gpu in ({"gpus": [{"count": -1}]}, {"deploy": RESERVED})
        ),
        (
            {"devices": CDI},
            {**ORIN, "toolkit": True},
            f"service node wants the CDI device {GPU}, and the robot does not have it: it has no CDI specification in /etc/cdi",
            "`sudo nvidia-ctk cdi generate --output=/etc/cdi/nvidia.yaml` on the robot",
        ),
        (
            {"devices": [{"source": "vendor.com/arm=left"}]},
            {"hardware_cdi": ("vendor.com/arm=right",)},
            "service node wants the CDI device vendor.com/arm=left, and the robot does not have it: it has vendor.com/arm=right",
            "correct `devices:` of node",
        ),
        (
            {"devices": CDI},
            {"hardware_cdi": (GPU,)},
            f"service node wants the CDI device {GPU}, and CDI is off in the robot's Docker 28.0.4",
            (
                'write `"features": {"cdi": true}` into /etc/docker/daemon.json on the robot (Docker 25 or newer), and restart '
                "Docker: `sudo systemctl restart docker`"
            ),
        ),
        (
            {"devices": ["/dev/ttyUSB0:/dev/lidar"]},
            {"devices": ALL},
            (
                "service node wants /dev/ttyUSB0, which the robot does not have: it has /dev/ttyACM0, "
                "/dev/serial/by-id/usb-Arduino-if00"
            ),
            "plug it in; or correct the path in `devices:` (`fab inventory --facts --hosts pi1` lists devices)",
        ),
        (
            {"ports": [{"target": 80, "published": "80"}]},
            {"docker_version": "28.1.0", "raw_table": False},
            "service node publishes ports, and Docker 28.1.0 cannot do that here: the robot's kernel has no iptables table `raw`",
            (
                "write `network_mode: host` in place of `ports:`; or write `docker: {version: 27.5.1}` for pi1 in the inventory, "
                "remove Docker on the robot, and `fab provision --hosts pi1`"
            ),
        ),
    ],
)
def test_a_robot_that_lacks_it(service: dict[str, Any], seen: dict[str, Any], what: str, cure: str) -> None:
    """Docker would say so after the old containers were stopped, or would start a container without CUDA."""
    assert refused(service, **seen) == (what, cure)


def test_an_image_for_another_l4t() -> None:
    """Libraries of one major version do not run on another."""
    what, cure = refused({}, made_for="35.4.1", **ORIN)
    assert what == "the image talker:latest-arm64 is made for L4T 35.4.1, and the robot has L4T 36.4.0"
    assert cure == "use an image for L4T 36 (its tag often has `r36`), and run `fab build`"


LIDAR = {"lidar": Usb(vendor="10c4", product="ea60")}
PI4: dict[str, Any] = {"boot_folder": "/boot/firmware", "devices": ("/dev/null",)}
REBOOT = "reboot it to switch on i2c: `fab run --hosts pi1 -- sudo reboot`"


@pytest.mark.parametrize(
    ("said", "seen", "cure"),
    [
        ({"devices": ["/dev/lidar"], "udev": LIDAR}, {}, "`fab provision --hosts pi1` gives it that name"),
        (
            {"devices": ["/dev/lidar"], "udev": LIDAR},
            {"udev_rules": 'SYMLINK+="lidar"'},
            "plug it in; `udev:` of pi1 says how it is recognised, and `lsusb` on the robot what is there",
        ),
        (
            {"devices": ["/dev/i2c-1"]},
            {},
            "write `hardware: {interfaces: [i2c]}` for pi1 in the inventory; `fab provision --hosts pi1`",
        ),
        (
            {"devices": ["/dev/i2c-1"], "interfaces": ["i2c"]},
            {},
            "`fab provision --hosts pi1`, then reboot it",
        ),
        ({"devices": ["/dev/i2c-1"]}, {"interfaces": ("i2c",), "reboot_for": ("i2c",)}, REBOOT),
        (
            {"devices": ["/dev/serial/by-id/x"]},
            {},
            "plug it in; or correct the path in `devices:` (`fab inventory --facts --hosts pi1` lists devices)",
        ),
    ],
)
def test_a_device_that_the_inventory_expects(said: dict[str, Any], seen: dict[str, Any], cure: str) -> None:
    """Each has the cure of its kind: plug it in, name it, switch it on, reboot."""
    device = said["devices"][0]
    assert refused({}, of=Hardware(**said), **PI4, **seen) == (
        f"the inventory expects {device}, which the robot does not have: nothing of that kind is plugged in",
        cure,
    )
