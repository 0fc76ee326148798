from __future__ import annotations

import re

import pytest

from fleet.diagnosis import explain
from fleet.diagnosis.known_errors import KNOWN_ERRORS

# What the tools really print: Docker 20.10 and 26.1, Compose 2.26, apt 3.0 and dpkg 1.22, sudo 1.9, curl 8, dash, bash.
HEARD = [
    (
        "mkdir: cannot create directory '.fleet/releases/4b116d72170f.513.part': Permission denied",
        "something in the robot's ~/.fleet belongs to another user",
        "sudo chown",
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
        "the robot's clock cannot be set",
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
        "the robot's package sources do not have docker-ce",
        "apt-get update",
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
        "apt-cache madison",
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
        "fab build",
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
    (
        "dependency failed to start: container talker-talker-1 is unhealthy",
        "container talker-talker-1 is unhealthy",
        "fab logs",
    ),
    ("container talker-talker-1 exited (3)", "container talker-talker-1 ended with code 3", "fab logs"),
    ("bash: line 1: nosuchcommand: command not found", "nosuchcommand is not installed", ""),
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
        next(s for s in KNOWN_ERRORS if re.search(s.pattern, output, re.MULTILINE)) for output, _, _ in HEARD
    }
    assert {sign.what for sign in KNOWN_ERRORS} - {sign.what for sign in shown} == {
        "the robot's disk cannot be read or written",
        "the robot ran out of memory",
        "the robot cannot resolve host names: no DNS or no internet",
        "Docker's install script does not support the robot's {0}, {1}",
        "the robot's system has no package with the Compose plugin",
        "the package archive changed during the download",
        "apt cannot resolve the dependencies of the robot's packages",
        "Docker cannot set up its network: the robot's kernel lacks iptables modules",
        "a port is already in use on the robot",
        "the robot's kernel does not support memory limits",
        "a file or device on the robot is in use",
    }


def test_the_cause_comes_before_what_follows_from_it() -> None:
    """A full disk also cuts off an image."""
    said = "Error processing tar file(exit status 1): write /usr/lib/x.so: no space left on device\nunexpected EOF"
    assert explain.explain(said)[0] == "the robot's disk is full"
