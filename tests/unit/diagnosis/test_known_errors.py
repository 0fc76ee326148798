from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pytest

from fleet.cli import deploy
from fleet.diagnosis import explain
from fleet.diagnosis.known_errors import KNOWN_ERRORS
from fleet.plan import containers, ship
from fleet.plan.compose_steps import Request
from fleet.plan.delivery import Delivery
from fleet.provision import steps
from tests.support.samples import NOW, PI, facts, release
from tests.unit.diagnosis.test_installer_errors import INSTALLERS
from tests.unit.diagnosis.test_registry_errors import PULLS

if TYPE_CHECKING:
    from fleet.diagnosis.known_error import KnownError

VERBS = ("", "provision", "ship", "rollback", "prune", "start", "stop", "restart", "remove")
"""Those that run steps on robots, and none, as when a robot is only looked at."""

REQUEST = Request(by="tim@desktop", run="1")

# What the tools really print: Docker 20.10 and 26.1, Compose 2.26, apt 3.0 and dpkg 1.22, sudo 1.9, curl 8, dash, bash.
HEARD = [
    (  # Docker 28 on a Jetson (NVIDIA/NemoClaw #1076)
        "iptables v1.8.9 (legacy): can't initialize iptables table `raw': Table does not exist",
        "the robot's kernel has no iptables table `raw`, which Docker 28 and newer need",
        "version: 27.5.1",
    ),
    (
        "mkdir: cannot create directory '.fleet/releases/4b116d72170f.513.part': Permission denied",
        "something in the robot's ~/.fleet belongs to another user",
        "sudo find ~/.fleet -path '*/data' -prune",
    ),
    *(
        (
            f"the robot's data cannot be written: {what} '/home/pi/.fleet/stacks/own/data/cfg/tune.yaml': Permission denied",
            "a file of the project cannot be laid into /home/pi/.fleet/stacks/own/data/cfg: a container has made this folder its own",
            "sudo chgrp $(id -gn) /home/pi/.fleet/stacks/own/data/cfg && sudo chmod g+rwx",
        )
        for what in ("cp: cannot create regular file", "cannot reach")
    ),
    ("tim@desktop is shipping to this robot", "tim@desktop is shipping to this robot now", "wait until"),
    (
        "write /var/lib/docker/tmp/GetImageBlob1: no space left on device",
        "the robot's disk is full",
        "df -h",
    ),
    (
        "E: You don't have enough free space in /var/cache/apt/archives/.",
        "the robot's disk is full",
        "apt-get clean",
    ),
    (
        "mkdir: cannot create directory '.fleet': Read-only file system",
        "a file system became read-only",
        "SD card",
    ),
    (
        "date: cannot set date: Operation not permitted\nThu Jan  1 00:00:00 UTC 1970",
        "the robot's system lets nobody set its clock",
        "timedatectl",
    ),
    (
        (
            "E: Release file for http://deb.debian.org/debian/dists/trixie/InRelease is not valid yet (invalid for another"
            " 8d 2h 1min 3s). Updates for this repository will not be applied."
        ),
        "the robot's clock is behind",
        "fab provision",
    ),
    (
        (
            "W: OpenPGP signature verification failed: http://deb.debian.org/debian trixie-updates InRelease: Sub-process"
            " /usr/bin/sqv returned an error code (1), error message is: Verifying signature:            Not live until"
            " 2026-11-22T01:39:45Z\nW: Some index files failed to download. They have been ignored, or old ones used instead."
        ),
        "the robot's clock is behind",
        "fab provision",
    ),
    (
        (
            "E: Release file for http://deb.debian.org/debian/dists/trixie-updates/InRelease is expired (invalid since 8433d"
            " 21h 50min 55s). Updates for this repository will not be applied."
        ),
        "the robot's clock is ahead",
        "fab provision",
    ),
    ("sudo: a password is required", "sudo asks the login user for a password", "NOPASSWD"),
    (
        "sudo: a terminal is required to read the password; either use the -S option to read from standard input",
        "sudo asks the login user for a password",
        "NOPASSWD",
    ),
    ("tim is not in the sudoers file.", "tim is not allowed to use sudo", "usermod -aG sudo tim"),
    (
        (
            "E: Could not get lock /var/lib/apt/lists/lock. It is held by process 1885 (unattended-upgr)\n"
            "E: Unable to lock directory /var/lib/apt/lists/"
        ),
        "another program on the robot uses apt (unattended-upgr)",
        "wait until it has finished",
    ),
    (
        (
            "dpkg: error: dpkg frontend lock was locked by /usr/bin/python3.13 process with pid 1899\n"
            "Note: removing the lock file is always wrong, can damage the locked area"
        ),
        "another program on the robot uses apt (/usr/bin/python3.13)",
        "wait until it has finished",
    ),
    (
        "E: Unable to acquire the dpkg frontend lock (/var/lib/dpkg/lock-frontend), is another process using it?",
        "another program on the robot uses apt",
        "wait until it has finished",
    ),
    (
        "E: dpkg was interrupted, you must manually run 'dpkg --configure -a' to correct the problem. ",
        "dpkg was interrupted",
        "fab provision",
    ),
    (
        (
            "Err:1 http://deb.debian.org/debian trixie/main amd64 hello amd64 2.10-5\n"
            "  Temporary failure resolving 'deb.debian.org'\n"
            "E: Failed to fetch http://deb.debian.org/debian/pool/main/h/hello/hello_2.10-5_amd64.deb  Temporary failure"
            " resolving 'deb.debian.org'\nE: Unable to fetch some archives, maybe run apt-get update or try with --fix-missing?"
        ),
        "the robot cannot resolve deb.debian.org: no DNS or no internet",
        "ping",
    ),
    ("curl: (6) Could not resolve host: get.docker.com", "the robot cannot resolve get.docker.com", "ping"),
    (
        "curl: (7) Failed to connect to 127.0.0.1 port 1 after 0 ms: Could not connect to server",
        "the robot cannot reach 127.0.0.1",
        "ping",
    ),
    (
        "  Could not connect to deb.debian.org:80 (151.101.2.132), connection timed out",
        "the robot cannot reach deb.debian.org",
        "ping",
    ),
    ("curl: (28) Connection timed out after 10001 milliseconds", "a download took too long", "ping"),
    (
        "E: Unable to locate package nosuchpackage",
        "the robot's package sources do not have nosuchpackage",
        "apt-get update",
    ),
    (
        "E: Package 'docker-ce' has no installation candidate",
        "Docker's package server has no docker-ce for the robot's system",
        "docker.io",
    ),
    (
        "E: The repository 'http://deb.debian.org/debian nosuchsuite Release' does not have a Release file.",
        "apt rejects the package source http://deb.debian.org/debian nosuchsuite Release",
        "sources.list.d",
    ),
    (
        (
            "+ sh -c DEBIAN_FRONTEND=noninteractive apt-get -y -qq install docker.io >/dev/null\n"
            "dpkg: error processing package docker.io (--configure):\n"
            " installed docker.io package post-installation script subprocess returned error exit status 1\n"
            "Errors were encountered while processing:\n docker.io\n"
            "E: Sub-process /usr/bin/dpkg returned an error code (1)"
        ),
        "dpkg could not install docker.io: installed docker.io package post-installation script subprocess returned error",
        "dpkg --configure -a",
    ),
    (
        " trying to overwrite '/usr/libexec/docker/cli-plugins/docker-buildx', which is also in package docker-buildx 0.13.1",
        "the installed package docker-buildx conflicts",
        "apt-get remove docker-buildx",
    ),
    (
        "\nERROR: '99.1.1' not found amongst apt-cache madison results\n",
        "there is no Docker 99.1.1 for the robot's system",
        "version:",
    ),
    (
        (
            "permission denied while trying to connect to the Docker daemon socket at unix:///var/run/docker.sock: Get"
            ' "http://%2Fvar%2Frun%2Fdocker.sock/v1.45/containers/json": dial unix /var/run/docker.sock: connect: permission'
            " denied"
        ),
        "the login user is not allowed to use Docker",
        "fab provision",
    ),
    (
        "Cannot connect to the Docker daemon at unix:///var/run/docker.sock. Is the docker daemon running?",
        "Docker is not running",
        "journalctl -u docker",
    ),
    (
        (
            "Job for docker.service failed because the control process exited with error code.\n"
            'See "systemctl status docker.service" and "journalctl -xeu docker.service" for details.'
        ),
        "Docker does not start",
        "journalctl -u docker",
    ),
    (
        (
            "unable to configure the Docker daemon with file /etc/docker/daemon.json: the following directives don't match"
            " any configuration option: foo"
        ),
        "Docker rejects its configuration: the following directives don't match any configuration option: foo",
        "daemon.json",
    ),
    (
        "Failed to enable unit: Unit /etc/systemd/system/docker.service is masked",
        "Docker's service is masked",
        "unmask docker",
    ),
    ("Failed to enable unit: Unit docker.service does not exist", "Docker is not installed", "fab provision"),
    (
        "timeout: failed to run command 'docker': No such file or directory",
        "Docker is not installed",
        "fab provision",
    ),
    ("sh: 1: docker: not found", "Docker is not installed", "fab provision"),
    (
        "unknown shorthand flag: 'd' in -d\nSee 'docker --help'.\n\nUsage:  docker [OPTIONS] COMMAND\n\nRun 'docker'",
        "Docker's Compose plugin is missing",
        "fab provision",
    ),
    (
        "docker: 'compose' is not a docker command.\nSee 'docker --help'",
        "Docker's Compose plugin is missing",
        "fab provision",
    ),
    ("unknown flag: --waitx", "the robot's Docker does not know --waitx: it is too old", "apt-get"),
    ("exec /bin/true: exec format error", "a program was built for another processor", "platform"),
    (
        "docker: no matching manifest for linux/arm/v7 in the manifest list entries.",
        "the image does not exist for linux/arm/v7",
        "platform",
    ),
    (
        'invalid diffID for layer 1: expected "sha256:1", got "sha256:2"',
        "the image arrived damaged or incomplete",
        "again",
    ),
    ("unexpected EOF", "the image arrived damaged or incomplete", "again"),
    ("archive/tar: invalid tar header", "the image arrived damaged or incomplete", "again"),
    (
        (
            "Unable to find image 'nosuch:1' locally\ndocker: Error response from daemon: Get"
            ' "https://registry-1.docker.io/v2/": dial tcp: lookup registry-1.docker.io on 127.0.0.11:53: no such host.\n'
            "See 'docker run --help'."
        ),
        "the image nosuch:1 is not on the robot",
        "fab ship",
    ),
    (
        " Container tmp-a-1  Creating\nError response from daemon: No such image: x:latest",
        "the image x:latest is not on the robot",
        "fab ship",
    ),
    (
        (
            "docker: Error response from daemon: driver failed programming external connectivity on endpoint a (4706ad):"
            " Bind for 0.0.0.0:8080 failed: port is already allocated."
        ),
        "port 8080 is already in use on the robot",
        "ss -ltnp",
    ),
    (
        "Error starting userland proxy: listen tcp4 0.0.0.0:8081: bind: address already in use",
        "port 8081 is already in use on the robot",
        "ss -ltnp",
    ),
    (
        "failed to bind host port for 0.0.0.0:8082:172.17.0.2:80/tcp: address already in use",
        "port 8082 is already in use on the robot",
        "ss -ltnp",
    ),
    (
        'docker: Error response from daemon: Conflict. The container name "/one" is already in use by container "239839".',
        "another container on the robot is called one",
        "docker rm --force one",
    ),
    (
        (
            "docker: Error response from daemon: error gathering device information while adding custom device"
            ' "/dev/ttyUSB7": no such file or directory.'
        ),
        "the robot has no device /dev/ttyUSB7",
        "ls -l /dev/ttyUSB7",
    ),
    (
        'docker: Error response from daemon: could not select device driver "nvidia" with capabilities: [[gpu]].',
        "the robot's Docker has no runtime nvidia",
        "Jetson",
    ),
    (
        'docker: Error response from daemon: invalid mount config for type "bind": bind source path does not exist: /nope.',
        "a container needs /nope, which is not on the robot",
        "files:",
    ),
    (
        (
            'OCI runtime create failed: runc create failed: unable to start container process: exec: "/bin/nothing": stat'
            " /bin/nothing: no such file or directory: unknown."
        ),
        "the image cannot run /bin/nothing",
        "entry point",
    ),
    ("exec /bin/true: no such file or directory", "the image cannot run /bin/true", "entry point"),
    (
        "error while interpolating services.a.image: required variable X is missing a value: set it",
        "the stack needs the variable X (set it)",
        "environment:",
    ),
    ("no configuration file provided: not found", "the release is not on the robot", "fab ship"),
    (
        "env: cannot change directory to '.fleet/releases/abc': No such file or directory",
        "the release is not on the robot",
        "fab ship",
    ),
    (
        "yaml: line 1: did not find expected node content",
        "the Compose file is not valid: yaml: line 1: did not find expected node content",
        "fix",
    ),
    (
        "validating /tmp/compose.yaml: services.a Additional property foo is not allowed",
        "the Compose file is not valid: services.a Additional property foo is not allowed",
        "fix",
    ),
    (
        'service "a" depends on undefined service "b": invalid compose project',
        'the Compose file is not valid: service "a" depends on undefined service "b"',
        "fix",
    ),
    ('external volume "maps" not found', "the stack needs the volume maps", "docker volume create maps"),
    (
        "network site declared as external, but could not be found",
        "the stack needs the network site",
        "docker network create site",
    ),
    (
        'Error response from daemon: invalid CapAdd: capability not supported by your kernel or not available in the current environment: "CAP_SYS_NICE"',
        "the robot's kernel does not give containers the capability SYS_NICE",
        "remove SYS_NICE",
    ),
    (
        'error mounting "/home/pi/.fleet/x.yaml" to rootfs at "/params.yaml": mount src=/x, dst=/y: not a directory: unknown: Are you trying to mount a directory onto a file (or vice-versa)?',
        "/home/pi/.fleet/x.yaml cannot be mounted at /params.yaml: one of them is a file",
        "under `volumes:`",
    ),
    ("talker is not healthy yet after 180 s", "talker did not become healthy within 180 s", "--wait"),
    (
        "dependency failed to start: container talker-talker-1 is unhealthy",
        "talker-talker-1 is unhealthy",
        "fab logs",
    ),
    ("container talker-talker-1 exited (3)", "container talker-talker-1 ended with code 3", "fab logs"),
    (
        "bash: line 1: nosuchcommand: command not found",
        "the command nosuchcommand is missing on the robot",
        "apt-cache search nosuchcommand",
    ),
    # Which shells and tools say that a command is missing, and how.
    *(
        (output, "the command flock is missing on the robot", "apt-get install util-linux")
        for output in (
            "sh: 1: flock: not found",  # dash
            "swap: 54: flock: not found",  # dash, for a script with a name
            "sh: flock: not found",  # busybox 1.35
            "swap: line 54: flock: not found",  # busybox 1.36
            "bash: line 1: flock: command not found",
            "zsh:1: command not found: flock",
            "fish: Unknown command: flock",
            "flock: Command not found.",  # csh, tcsh
            "sudo: flock: command not found",
            "timeout: failed to run command \u2018flock\u2019: No such file or directory",
            "timeout: can't execute 'flock': No such file or directory",  # busybox
            "setsid: failed to execute flock: No such file or directory",
            "xargs: flock: No such file or directory",
            "env: 'flock': No such file or directory",
        )
    ),
    (
        (
            "env: invalid option -- 'C'\nBusyBox v1.35.0 (Debian 1:1.35.0-4+deb12u1+b1) multi-call binary.\n\n"
            "Usage: env [-i0] [-u NAME]... [-] [NAME=VALUE]... [PROG ARGS]"
        ),
        "env on the robot is busybox's, which lacks an option that fleet needs",
        "apt-get install coreutils",
    ),
    (
        # tcsh 6.24 and csh 20110502, given the probe
        "/bin/sh: Event not found.\nBadly placed ()'s.\nsection: Command not found.\ncat: 2: No such file or directory",
        "the login shell on the robot is csh or tcsh",
        "chsh -s /bin/bash",
    ),
    ("Unmatched '''.", "the login shell on the robot is csh or tcsh", "chsh -s /bin/bash"),
    (
        "This account is currently not available.",
        "the login's shell on the robot runs no commands",
        "usermod",
    ),
    *(
        (output, "the login user cannot write to its home on the robot", "sudo chown $(id -un): ~")
        for output in (
            "mkdir: cannot create directory '.fleet': Permission denied",
            "mkdir: cannot create directory \u2018/home/pi/.fleet\u2019: Permission denied",
            "mkdir: can't create directory '.fleet': Permission denied",  # busybox
        )
    ),
    (
        "sh: 1: cannot create .fleet/history: Permission denied",  # dash
        "something in the robot's ~/.fleet belongs to another user",
        "-exec chown $(id -un): {} +",
    ),
    (
        "failed to start daemon: error initializing graphdriver: driver not supported: foo",
        "Docker does not start: error initializing graphdriver: driver not supported: foo",
        "journalctl -u docker",
    ),
    (
        "Fatal glibc error: CPU does not support x86-64-v3",  # glibc 2.33 and newer
        "the image needs a newer processor (x86-64-v3) than the robot has",
        "build the image for the plain processor",
    ),
    (
        "This program can only be run on AMD64 processors with v3 microarchitecture support.",  # Go
        "the image needs a newer processor (v3) than the robot has",
        "GOAMD64",
    ),
    (
        "WARNING: The requested image's platform (linux/amd64/v3) does not match the detected host platform (linux/amd64/v2)",
        "the image was built for linux/amd64/v3",
        "build the image for the plain processor",
    ),
    (
        # Docker 26.1
        (
            "Error response from daemon: image with reference talker:fleet-1 was found but does not match the specified"
            " platform: wanted linux/amd64, actual: linux/amd64/v3"
        ),
        "the image talker:fleet-1 was built for linux/amd64/v3, a newer processor",
        "GOAMD64",
    ),
    (
        # Docker 28
        (
            "Error response from daemon: image with reference talker:fleet-1 was found but its platform (linux/arm64) does not"
            " match the specified platform (linux/amd64)"
        ),
        "the image talker:fleet-1 is for another platform: its platform (linux/arm64) does not match",
        "platform",
    ),
    ("talker has ended with code 132", "a program uses instructions that the robot's processor", "-march"),
    ("date: cannot set date: Invalid argument", "the robot's clock cannot be set", "timedatectl set-ntp"),
]


@pytest.mark.parametrize(("output", "what", "cure"), HEARD, ids=[what for _, what, _ in HEARD])
def test_what_tools_say_is_understood(output: str, what: str, cure: str) -> None:
    """The clause names the cause, the cure names something to do."""
    said = explain.explain(output)
    assert said[0].startswith(what)
    assert cure in said[1]
    assert not said[0].endswith(".")


def test_every_sign_was_heard() -> None:
    """A sign that nothing shows may be wrong, and nobody would know; these few could not be provoked."""
    shown = {
        next(s for s in KNOWN_ERRORS if re.search(s.pattern, output, re.MULTILINE)).what
        for output, _, _ in (*HEARD, *INSTALLERS, *PULLS)
    }
    assert {sign.what for sign in KNOWN_ERRORS} - shown == {
        "the robot's disk cannot be read or written",
        "the robot ran out of memory",
        "the robot cannot resolve host names: no DNS or no internet",
        "apt cannot resolve the dependencies of the robot's packages",
        "Docker cannot set up its network: the robot's kernel lacks iptables modules",
        "a port is already in use on the robot",
        "the robot's kernel does not support memory limits",
        "a file or device on the robot is in use",
    }


@pytest.mark.parametrize("verb", VERBS)
@pytest.mark.parametrize("known", KNOWN_ERRORS, ids=lambda known: known.pattern[:40])
def test_every_known_error_has_a_cure_that_makes_sense(known: KnownError, verb: str) -> None:
    """There is one; it is not the verb that is running, and it uses nothing that fleet itself takes away again."""
    cure = known.cure_during(verb, ["flock", "y"])
    assert cure
    assert not (verb and re.search(rf"\bfab {verb}\b", cure))
    for gone in (steps.SCRIPT, steps.PROOF_IMAGE, "docker.list", "apt-cache madison", "docker-ce"):
        assert gone not in cure


def test_the_same_command_again_is_a_cure_only_for_what_passes() -> None:
    """Else something has to be done, or waited for, before."""
    again = {
        known.what
        for known in KNOWN_ERRORS
        for verb in VERBS
        if known.cure_during(verb, ["flock", "y"]).startswith("run the same command again")
    }
    assert again == {
        "the package archive changed during the download",
        "the image arrived damaged or incomplete",
        "the package server {0} answers {1}: it is overloaded or down",
        "the server {0} does not answer",
        "a server answers the robot's download with {0}",
        "the robot lost the way to the images on this computer",
        "the registry does not have {0} with this digest any more",
        "a layer arrived damaged from the registry",
    }


def test_verbs_of_other_cures_exist() -> None:
    """A cure for a verb that is not there would never be shown."""
    there = {function.__name__ for function in deploy.VERBS}
    assert {verb for known in KNOWN_ERRORS for verb in known.during} <= there
    assert there == {*VERBS, "trust"} - {""}


def test_plans_say_which_verb_made_them() -> None:
    """The verbs above are those of the plans."""
    seen = facts(current="a", releases=("a",), containers=())
    plans = (
        ship.plan(robot=PI, release=release(), facts=facts(), delivery=Delivery(), request=REQUEST, keep=3),
        containers.plan("restart", robot=PI, stack="talker", facts=seen, request=REQUEST),
        containers.remove(robot=PI, stack="talker", facts=seen, by="tim@desktop"),
        steps.plan(robot=PI, facts=facts(clock=0.0), script=b"", now=NOW, by="tim@desktop"),
    )
    assert [plan.verb for plan in plans] == ["ship", "restart", "remove", "provision"]


def test_the_cause_comes_before_what_follows_from_it() -> None:
    """A full disk also cuts off an image."""
    said = "Error processing tar file(exit status 1): write /usr/lib/x.so: no space left on device\nunexpected EOF"
    assert explain.explain(said)[0] == "the robot's disk is full"
