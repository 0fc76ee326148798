"""Which error messages of tools on a robot do we know, what do they mean, and how are they fixed?

The tools are Docker, Compose, apt, dpkg, sudo, curl and shells. This is data only; `fleet.diagnosis.explain` reads it.
"""

from __future__ import annotations

from typing import NamedTuple


class KnownError(NamedTuple):
    """``what`` and ``cure`` may contain the groups of ``pattern`` that matched: {0} is the first of them."""

    pattern: str
    what: str
    cure: str


_PROVISION = "run `fab provision`"
_SHIP = "run the same command again: layers that arrived complete are not sent again"
_INTERNET = "check the robot's internet connection: `ping -c 1 deb.debian.org` on the robot"
_AGAIN = (
    "wait until it has finished (updates after the first boot take minutes), then run the same command again"
)
_NAMES = r"(?:[A-Za-z0-9][A-Za-z0-9.-]*)"

# The first match counts, so causes stand before the errors that follow from them.
KNOWN_ERRORS = (
    # The robot itself.
    KnownError(
        r"(?i)no space left on device|You don't have enough free space in|disk quota exceeded",
        "the robot's disk is full",
        "on the robot, `df -h` shows which; `sudo apt-get clean` and `docker image prune` free space",
    ),
    KnownError(
        r"(?i)read-only file system",
        "a file system became read-only, which often means a failing SD card",
        "reboot the robot; if the error returns, replace the SD card (`dmesg | grep -i mmc` shows its errors)",
    ),
    KnownError(
        r"(?i)input/output error",
        "the robot's disk cannot be read or written",
        "replace the SD card (`dmesg | grep -i mmc` on the robot shows its errors)",
    ),
    KnownError(
        r"(?i)cannot allocate memory|out of memory|signal: killed",
        "the robot ran out of memory",
        "`docker stats` on the robot shows which container uses it; use a smaller stack or add swap",
    ),
    KnownError(
        r"(?i)cannot set date",
        "the robot's clock cannot be set",
        "`timedatectl` on the robot shows what controls the clock",
    ),
    KnownError(
        r"is not valid yet|certificate is not yet valid|Not live until",
        "the robot's clock is behind, so downloads are rejected",
        "`fab provision` sets the clock",
    ),
    KnownError(
        r"Release file for (\S+) is expired",
        "the robot's clock is ahead, or {0} is no longer maintained",
        "`fab provision` sets the clock",
    ),
    KnownError(
        r"^(\S+) is shipping to this robot",
        "{0} is shipping to this robot now",
        "wait until that has finished, then run the same command again",
    ),
    KnownError(
        r"cannot (?:create|remove|move) .*'?\.fleet\b.*: Permission denied",
        "something in the robot's ~/.fleet belongs to another user",
        "`sudo chown -R $(id -un): ~/.fleet` on the robot; Docker creates missing bind-mount folders as root",
    ),
    # sudo.
    KnownError(
        r"sudo: (?:a password is required|a terminal is required|no tty present|sorry, you must have a tty)",
        "sudo asks the login user for a password",
        "on the robot, `sudo visudo -f /etc/sudoers.d/010_nopasswd`, and add: LOGIN ALL=(ALL) NOPASSWD: ALL",
    ),
    KnownError(
        r"(\S+) is not in the sudoers file|user (\S+) (?:may not run sudo|is not allowed to execute)",
        "{0} is not allowed to use sudo",
        "as root on the robot: `usermod -aG sudo {0}`",
    ),
    # A missing image: Docker then asks a registry, and the errors of that would mislead.
    KnownError(
        r"Unable to find image '([^']+)' locally|pull access denied for ([^, ]+)|No such image: (\S+)|manifest for (\S+) not found"
        r"|image (?:with reference )?\"?([^\s\"]+)\"? was (?:found but|not found)",
        "the image {0} is not on the robot",
        "`fab ship` sends it",
    ),
    # apt and dpkg.
    KnownError(
        r"It is held by process \d+ \(([^)]+)\)|lock was locked by (\S+) process with pid",
        "another program on the robot uses apt ({0})",
        _AGAIN,
    ),
    KnownError(
        r"Could not get lock|Unable to (?:lock (?:directory|the)|acquire the dpkg frontend lock)",
        "another program on the robot uses apt",
        _AGAIN,
    ),
    KnownError(r"dpkg was interrupted", "dpkg was interrupted while it worked", _PROVISION),
    KnownError(
        rf"Temporary failure resolving '([^']+)'|Could not resolve host:? '?({_NAMES})|lookup (\S+)(?: on \S+)?: ",
        "the robot cannot resolve {0}: no DNS or no internet",
        _INTERNET,
    ),
    KnownError(
        r"Temporary failure in name resolution",
        "the robot cannot resolve host names: no DNS or no internet",
        _INTERNET,
    ),
    KnownError(
        rf"(?:Could not|Unable to) connect to ({_NAMES})|Cannot initiate the connection to ({_NAMES})"
        rf"|Failed to connect to ({_NAMES}) port",
        "the robot cannot reach {0}",
        _INTERNET,
    ),
    KnownError(r"curl: \(28\)", "a download took too long", _INTERNET),
    KnownError(
        r"trying to overwrite '[^']+', which is also in package (\S+)",
        "the installed package {0} conflicts with the new one",
        "`sudo apt-get remove {0}` on the robot, then run the same command again",
    ),
    KnownError(
        r"^dpkg: error processing (?:archive|package) (?:\S*/)?(\S+) \(.*\):\n (.+)",
        "dpkg could not install {0}: {1}",
        "`sudo dpkg --configure -a` on the robot repeats the error",
    ),
    KnownError(
        r"ERROR: '([^']+)' not found amongst apt-cache madison results",
        "there is no Docker {0} for the robot's system",
        "set another version in the inventory: `apt-cache madison docker-ce` on the robot lists them",
    ),
    KnownError(
        r"ERROR: Unsupported (distribution|operating system) '([^']+)'",
        "Docker's install script does not support the robot's {0}, {1}",
        "install Docker on the robot by hand, then run `fab provision` for the rest",
    ),
    KnownError(
        r"no package of this system brings the Compose plugin",
        "the robot's system has no package with the Compose plugin",
        "",
    ),
    KnownError(
        r"Unable to locate package (\S+)|Package '([^']+)' has no installation candidate",
        "the robot's package sources do not have {0}",
        "`sudo apt-get update` on the robot shows whether they work",
    ),
    KnownError(
        r"The repository '([^']+)' (?:does not have a Release file|is not signed|is no longer signed)",
        "apt rejects the package source {0}",
        "fix or remove it on the robot, in /etc/apt/sources.list.d/",
    ),
    KnownError(
        r"Hash Sum mismatch|Failed to fetch \S+ +404",
        "the package archive changed during the download",
        "run the same command again",
    ),
    KnownError(
        r"have unmet dependencies|you have held broken packages|Unmet dependencies",
        "apt cannot resolve the dependencies of the robot's packages",
        "`sudo apt-get --fix-broken install` on the robot",
    ),
    # Docker.
    KnownError(
        r"(?i)permission denied while trying to connect to the Docker|docker\.sock: connect: permission denied",
        "the login user is not allowed to use Docker",
        _PROVISION,
    ),
    KnownError(
        r"unable to configure the Docker daemon with file \S+: (.+)",
        "Docker rejects its configuration: {0}",
        "fix /etc/docker/daemon.json on the robot, then run `fab provision`",
    ),
    KnownError(
        r"(?i)iptables.*(?:No chain/target/match|does not exist|can't initialize)|Failed to Setup IP tables",
        "Docker cannot set up its network: the robot's kernel lacks iptables modules",
        "reboot the robot: an update may have replaced the running kernel's modules",
    ),
    KnownError(
        r"(?i)Cannot connect to the Docker daemon|failed to connect to the docker API",
        "Docker is not running",
        f"{_PROVISION}; `journalctl -u docker` on the robot shows why it stopped",
    ),
    KnownError(
        r"Job for docker\.service failed|docker\.service: (?:Start request repeated|Failed with result)",
        "Docker does not start",
        "`journalctl -u docker` on the robot shows why",
    ),
    KnownError(
        r"Unit \S*docker\.service is masked",
        "Docker's service is masked",
        "`sudo systemctl unmask docker` on the robot",
    ),
    KnownError(
        r"docker: (?:command )?not found|failed to run command .docker.|sudo: docker: command not found"
        r"|Unit (?:file )?docker\.service (?:does not exist|not found|could not be found)",
        "Docker is not installed",
        _PROVISION,
    ),
    KnownError(
        # Without the plugin, `docker` parses Compose's options as its own.
        r"'compose' is not a docker command|unknown (?:docker )?command: \"?(?:docker )?compose"
        r"|unknown (?:shorthand )?flag: .*\s+(?:See 'docker --help'|Usage: +docker \[OPTIONS\])",
        "Docker's Compose plugin is missing",
        _PROVISION,
    ),
    KnownError(
        r"(?i)exec format error",
        "a program was built for another processor",
        "check `platform` in the inventory, then run `fab build` and `fab ship`",
    ),
    KnownError(
        r"(?i)no matching manifest for (\S+)",
        "the image does not exist for {0}",
        "check `platform` in the inventory, then run `fab build` and `fab ship`",
    ),
    KnownError(
        r"(?i)invalid diffID for layer|wrong diff id|layers from manifest don't match|unexpected EOF|invalid tar header",
        "the image arrived damaged or incomplete",
        _SHIP,
    ),
    KnownError(
        r"Bind for \S*:(\d+) failed|failed to bind host port (?:for )?\S*?:(\d+)[:/]|(?:listen|bind) \w+ \S*:(\d+): bind: address already in use|port is already allocated()",
        "port {0} is already in use on the robot",
        "`sudo ss -ltnp` on the robot shows by which program",
    ),
    KnownError(
        r"(?i)address already in use",
        "a port is already in use on the robot",
        "`sudo ss -ltnp` on the robot shows by which program",
    ),
    KnownError(
        r'container name "/?([^"]+)" is already in use',
        "another container on the robot is called {0}",
        "`docker rm --force {0}` on the robot, if it is not needed",
    ),
    KnownError(
        r'adding custom device "([^"]+)": no such file|error gathering device information.*"([^"]+)"',
        "the robot has no device {0}",
        "check that it is plugged in: `ls -l {0}` on the robot",
    ),
    KnownError(
        r"bind source path does not exist: (\S+?)\.?(?:\s|$)",
        "a container needs {0}, which is not on the robot",
        "create it on the robot, or list it under `files:` in the inventory",
    ),
    KnownError(
        r'could not select device driver "([^"]*)"|unknown or invalid runtime name: (\S+)',
        "the robot's Docker has no runtime {0}",
        "on a Jetson, install nvidia-container-toolkit",
    ),
    KnownError(
        r"(?i)memory (?:controller|cgroup).*(?:disabled|not (?:found|available|enabled))|cgroup.*memory.*no such file",
        "the robot's kernel does not support memory limits",
        "on the robot, add `cgroup_enable=memory` to the line in /boot/firmware/cmdline.txt, and reboot",
    ),
    KnownError(
        r'exec: "([^"]+)": (?:executable file not found|stat|permission denied)|^exec (\S+): no such file',
        "the image cannot run {0}",
        "fix the service's `command` or the image's entry point",
    ),
    KnownError(
        r"(?i)device or resource busy",
        "a file or device on the robot is in use",
        "reboot the robot if the error stays",
    ),
    # Compose.
    KnownError(
        r"required variable (\S+) is missing a value: *(.*)",
        "the stack needs the variable {0} ({1})",
        "set it under `environment:` in the inventory",
    ),
    KnownError(
        r"no configuration file provided|cannot change directory to .*releases/([\w.-]*)|stat \S*compose\.yaml: no such file",
        "the release is not on the robot",
        "`fab ship` writes it",
    ),
    KnownError(
        r"(yaml: .+)|validating \S+: (.+)|(?:parsing \S+: |)(services\.\S+ .+)|(service \"[^\"]+\" .*undefined.*)",
        "the Compose file is not valid: {0}",
        "fix it, then run the same command again",
    ),
    KnownError(r"(container \S+ is unhealthy)", "{0}", "`fab logs` shows its output"),
    KnownError(
        r"container (\S+) exited \((\d+)\)",
        "container {0} ended with code {1}",
        "`fab logs` shows its output",
    ),
    KnownError(
        r"unknown (?:shorthand )?flag: (.+)",
        "the robot's Docker does not know {0}: it is too old",
        "update it on the robot: `sudo apt-get update && sudo apt-get upgrade`",
    ),
    # Shells.
    KnownError(
        r"failed to run command .([\w./-]+).: No such file|sh: \d+: ([\w./-]+): not found|(\S+): command not found",
        "{0} is not installed",
        "",
    ),
)
