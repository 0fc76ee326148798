from __future__ import annotations

import pytest

from fleet.errors import NotReady
from fleet.plan.readiness import ready
from tests.support.samples import PI, facts


@pytest.mark.parametrize(
    ("values", "what", "cure"),
    [
        ({"docker_state": "absent"}, "Docker is not installed", "`fab provision --hosts pi1`"),
        (
            {"docker_state": "stopped"},
            "Docker is installed and not running",
            "`fab provision --hosts pi1`, or see `journalctl -u docker` there",
        ),
        (
            {"docker_state": "forbidden"},
            "pi may not use Docker",
            "`fab provision --hosts pi1` puts the login into the docker group",
        ),
        ({"compose": ""}, "Docker's Compose plugin is missing", "`fab provision --hosts pi1`"),
        (
            {"userland": "armhf"},
            "it runs linux/arm/v7, and the inventory says linux/arm64",
            "set `platform: linux/arm/v7` for pi1",
        ),
        (
            {"machine": "x86_64", "userland": "amd64", "emulates": ("qemu-arm",)},
            "it runs linux/amd64 and linux/arm/v7, and the inventory says linux/arm64",
            "set `platform: linux/amd64` for pi1",
        ),
        (
            {"machine": "armv6l", "userland": "armhf"},
            "there are no images for its processor (armv6l)",
            "use a computer that runs linux/arm64, linux/arm/v7 or linux/amd64",
        ),
        (
            {"docker_kind": "podman", "installed": ("podman-docker",)},
            "its `docker` command leads to podman, which fleet cannot use",
            "`sudo apt-get remove podman-docker` on the robot (podman itself may stay); then `fab provision --hosts pi1`",
        ),
        (
            {"docker_kind": "podman"},
            "its `docker` command leads to podman, which fleet cannot use",
            (
                "remove what leads to podman on the robot: its `docker` command, DOCKER_HOST, or the link /run/docker.sock; "
                "then `fab provision --hosts pi1`"
            ),
        ),
        (
            {"docker_kind": "rootless"},
            "its Docker is rootless: containers reach neither the robot's network nor its devices",
            (
                "`dockerd-rootless-setuptool.sh uninstall` and `docker context use default` on the robot; "
                "then `fab provision --hosts pi1`"
            ),
        ),
        (
            {"docker_kind": "snap"},
            "its Docker is snap's, which cannot read ~/.fleet",
            (
                "`sudo snap remove docker` on the robot, which also removes its containers, images and volumes; "
                "then `fab provision --hosts pi1`"
            ),
        ),
        (
            {"missing": ("sha256sum", "env", "flock")},
            "commands that fleet needs are missing on it, or are busybox's: sha256sum, env, flock",
            "`sudo apt-get install coreutils util-linux` on the robot; then run the same command again",
        ),
        (
            {"home_state": "missing"},
            "pi has no home directory: /home/pi is missing",
            "create it on the robot: `sudo mkhomedir_helper pi`, or change it with `usermod`; then run the same command again",
        ),
        (
            {"home_state": "foreign"},
            "pi cannot write to its home /home/pi, which belongs to another user",
            "`sudo chown pi: /home/pi` on the robot; then run the same command again",
        ),
    ],
)
def test_a_robot_that_cannot_run_containers_is_refused_with_the_cure(
    values: dict[str, object], what: str, cure: str
) -> None:
    """Before anything is planned."""
    with pytest.raises(NotReady) as caught:
        ready(facts(**values), robot=PI)
    assert (caught.value.what, caught.value.cure) == (what, cure)


def test_a_robot_that_is_ready_passes() -> None:
    """Its own platform, and those that it emulates."""
    ready(facts(), robot=PI)
    ready(facts(machine="x86_64", userland="amd64", emulates=("qemu-aarch64",)), robot=PI)
