"""Which error messages of tools on a robot do we know, what do they mean, and how are they fixed?

The tools are Docker, Compose, apt, dpkg, sudo, curl and shells. This is data only; `fleet.diagnosis.explain` reads it.
"""

from __future__ import annotations

import re

from fleet.diagnosis.installer_errors import INSTALLER_ERRORS
from fleet.diagnosis.known_error import KnownError
from fleet.diagnosis.packages import PACKAGES
from fleet.diagnosis.registry_errors import REGISTRY_ERRORS

_PROVISION = "run `fab provision`"
_STARTING = ("ship", "rollback", "start", "restart")
"""The verbs that show the output of containers, too: a program that is missing there is missing in the image."""
_SHIP = "run the same command again: layers that arrived complete are not sent again"
_CLOCKS = "compare `date -u` on the robot and on this computer: the robot was given the time of this computer"
_COMPOSE_BY_HAND = "https://docs.docker.com/compose/install/linux"
_JOURNAL = "`sudo journalctl -u docker` on the robot shows why; fix that, then run the same command again"
_PLATFORM = "check `platform` in the inventory, then build the image again and ship it"
_LEVEL = (
    "build the image for the plain processor: another base image, or no -march and no GOAMD64; then ship it"
)
_WORD = r"[\w.+-]+"
_PACKAGED = "|".join(map(re.escape, PACKAGES))


def _missing(words: str) -> str:
    """The pattern of a shell or a tool that cannot find one of these commands."""
    # dash and busybox: `name: 1: flock: not found`; bash, sudo, csh: `flock: command not found`; zsh and fish name it last;
    # GNU's timeout, env, xargs and setsid, and busybox's.
    return (
        rf"^(?:\S+: (?:line )?\d+: |-?(?:ba|da|a)?sh: )({words}): not found"
        rf"|(?:^|[\s:])({words}): (?:[Cc]ommand|inaccessible or) not found"
        rf"|command not found: ({words})|Unknown command:? '?({words})"
        rf"|(?:failed to run command|failed to execute|can't execute|^xargs:|^env:) ['\u2018]?({words})['\u2019]?: No such file"
    )


# The first match counts, so causes stand before the errors that follow from them.
KNOWN_ERRORS = (
    # The robot itself. A csh prints a line of noise for each line of a script, so it comes first.
    KnownError(
        r"^Badly placed \(\)'s\.|: Event not found\.|^Unmatched ['\"`]",
        "the login shell on the robot is csh or tcsh, which fleet cannot use",
        "give the login another shell on the robot: `chsh -s /bin/bash`",
    ),
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
        r"(?i)cannot set date: Operation not permitted",
        "the robot's system lets nobody set its clock, not even root, as in a container",
        "set the clock of the computer that the system runs on, such as with `sudo timedatectl set-ntp true` there",
    ),
    KnownError(
        r"(?i)cannot set date|can't set date",
        "the robot's clock cannot be set",
        "set it on the robot: `sudo timedatectl set-ntp true` takes the time from the network; `timedatectl` shows the result",
    ),
    KnownError(
        r"is not valid yet|certificate is not yet valid|Not live until",
        "the robot's clock is behind, so downloads are rejected",
        "`fab provision` sets the clock",
        {"provision": _CLOCKS},
    ),
    KnownError(
        r"Release file for (\S+) is expired",
        "the robot's clock is ahead, or {0} is no longer maintained",
        "`fab provision` sets the clock",
        {"provision": f"{_CLOCKS}; or, if both are right, name another package source on the robot"},
    ),
    KnownError(
        r"^(\S+) is shipping to this robot",
        "{0} is shipping to this robot now",
        "wait until that has finished, then run the same command again",
    ),
    KnownError(
        r"(?:cannot|can't) create(?: directory)? ['\u2018]?(?:/\S+/)?\.fleet['\u2019]?: (?:Permission denied|No such file)",
        "the login user cannot write to its home on the robot",
        "`ls -ld ~` on the robot shows whose it is; `sudo chown $(id -un): ~` gives it to the login",
    ),
    KnownError(
        r"(?:cannot|can't) .*['\u2018](/\S*/\.fleet/stacks/[^/]+/data/\S*)/[^/]*['\u2019]?: Permission denied",
        "a file of the project cannot be laid into {0}: a container has made this folder its own",
        "`sudo chgrp $(id -gn) {0} && sudo chmod g+rwx {0}` on the robot; or mount what the project brings beside it, read-only",
    ),
    KnownError(
        r"(?:cannot|can't) (?:create|remove|move) .*'?\.fleet\b.*: Permission denied",
        "something in the robot's ~/.fleet belongs to another user",
        # What containers have written keeps its owner.
        "on the robot: `sudo find ~/.fleet -path '*/data' -prune -o -exec chown $(id -un): {{}} +`",
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
    KnownError(
        r"image (?:with reference )?\"?([^\s\"]+?)\"? was found but .*platform\W.*(linux/amd64/v\d)",
        "the image {0} was built for {1}, a newer processor than linux/amd64 means",
        _LEVEL,
    ),
    KnownError(
        r"image (?:with reference )?\"?([^\s\"]+?)\"? was found but (.*platform.*)",
        "the image {0} is for another platform: {1}",
        _PLATFORM,
    ),
    # A missing image: Docker then asks a registry, and the errors of that would mislead.
    KnownError(
        r"Unable to find image '([^']+)' locally|pull access denied for ([^, ]+)|No such image: (\S+)|manifest for ([^\s@]+) not found"
        r"|image (?:with reference )?\"?([^\s\"]+)\"? was not found",
        "the image {0} is not on the robot",
        "`fab ship` sends it",
        {
            "ship": "another command has removed it meanwhile, such as `docker image prune`; run the same command again",
            "provision": "another command has removed it meanwhile, such as `docker image prune`; run the same command again",
        },
    ),
    *REGISTRY_ERRORS,
    *INSTALLER_ERRORS,
    # Docker.
    KnownError(
        r"(?i)permission denied while trying to connect to the Docker|docker\.sock: connect: permission denied",
        "the login user is not allowed to use Docker",
        _PROVISION,
        {
            "provision": "compare `ls -l /var/run/docker.sock` and `id` on the robot: the socket's group must be one of the "
            "login's"
        },
    ),
    KnownError(
        r"unable to configure the Docker daemon with file \S+: (.+)",
        "Docker rejects its configuration: {0}",
        "fix /etc/docker/daemon.json on the robot, then run `fab provision`",
        {"provision": "fix /etc/docker/daemon.json on the robot, then run the same command again"},
    ),
    KnownError(
        r"can't initialize iptables table `raw'",
        "the robot's kernel has no iptables table `raw`, which Docker 28 and newer need",
        "write `version: 27.5.1` under `docker:` of the robot in the inventory, remove Docker on the robot, then run `fab provision`",
        {
            "provision": "write `version: 27.5.1` under `docker:` of the robot in the inventory, remove Docker on the robot, then "
            "run the same command again"
        },
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
        {"provision": _JOURNAL},
        vague=True,
    ),
    KnownError(
        r"failed to start daemon: (.+)",
        "Docker does not start: {0}",
        _JOURNAL,
    ),
    KnownError(
        r"Job for docker\.service failed|docker\.service: (?:Start request repeated|Failed with result)",
        "Docker does not start",
        _JOURNAL,
        vague=True,
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
        {
            "provision": "`ls -l /usr/bin/docker* /usr/local/bin/docker*` on the robot shows whether the script installed it "
            "outside the PATH of logins by SSH"
        },
    ),
    KnownError(
        # Without the plugin, `docker` parses Compose's options as its own.
        r"'compose' is not a docker command|unknown (?:docker )?command: \"?(?:docker )?compose"
        r"|unknown (?:shorthand )?flag: .*\s+(?:See 'docker --help'|Usage: +docker \[OPTIONS\])",
        "Docker's Compose plugin is missing",
        _PROVISION,
        {"provision": f"install it on the robot by hand: {_COMPOSE_BY_HAND}"},
    ),
    KnownError(
        r"(?i)exec format error",
        "a program was built for another processor",
        _PLATFORM,
        {
            "provision": "compare `uname -m`, `dpkg --print-architecture` and `docker version` on the robot: its Docker is for "
            "another processor than its system"
        },
    ),
    KnownError(
        r"(?i)no matching manifest for (\S+)",
        "the image does not exist for {0}",
        _PLATFORM,
    ),
    KnownError(
        r"(?i)CPU does not support (x86-64-v\d)|AMD64 processors with (v\d) microarchitecture",
        "the image needs a newer processor ({0}) than the robot has",
        _LEVEL,
    ),
    KnownError(
        r"platform \((linux/amd64/v\d)\) does not match the detected host platform",
        "the image was built for {0}, a newer processor than the robot has",
        _LEVEL,
    ),
    KnownError(
        r"(?i)illegal instruction|(?:with code|exit code|exited) \(?132\b",
        "a program uses instructions that the robot's processor does not have",
        _LEVEL,
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
        "on the robot, add `cgroup_enable=memory` to the line in /boot/firmware/cmdline.txt (Ubuntu since 25.10: current/cmdline.txt in that folder), and reboot",
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
        {"ship": "another command has removed it meanwhile; run the same command again"},
    ),
    KnownError(
        r"(yaml: .+)|validating \S+: (.+)|(?:parsing \S+: |)(services\.\S+ .+)|(service \"[^\"]+\" .*undefined.*)",
        "the Compose file is not valid: {0}",
        "fix it, then run the same command again",
        {
            "ship": "the robot's Compose is older than this computer's, and does not know it: "
            "leave it out, or install a newer Compose on the robot (`fab status --json` shows the version)"
        },
    ),
    KnownError(
        r'external volume "([^"]+)" not found',
        "the stack needs the volume {0}, which it says somebody else makes (`external: true`)",
        "`docker volume create {0}` on the robot, or remove `external:` from the Compose file",
    ),
    KnownError(
        r"network (\S+) declared as external, but could not be found",
        "the stack needs the network {0}, which it says somebody else makes (`external: true`)",
        "`docker network create {0}` on the robot, or remove `external:` from the Compose file",
    ),
    KnownError(
        r'invalid Cap(?:Add|Drop): .*"CAP_(\w+)"',
        "the robot's kernel does not give containers the capability {0}",
        "remove {0} from `cap_add:` in the Compose file",
    ),
    KnownError(
        r'error mounting "([^"]+)" to rootfs at "([^"]+)".*not a directory',
        "{0} cannot be mounted at {1}: one of them is a file, and the other one a folder",
        "correct the path under `volumes:`; if it should be a file, check that it is in the project's folder",
    ),
    KnownError(
        r"(\S+) is not healthy yet after (\d+) s",
        "{0} did not become healthy within {1} s",
        "`fab logs` shows its output; a node that needs longer: --wait SECONDS, or `start_period` in the Compose file",
    ),
    KnownError(
        r"(\S+) is unhealthy",
        "{0} is unhealthy",
        "`fab logs` shows its output",
    ),
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
    # Shells and commands.
    KnownError(
        r"This account is (?:currently )?not available",
        "the login's shell on the robot runs no commands",
        "give the login a shell: `sudo usermod -s /bin/bash LOGIN` on the robot; or name another `user:` in the inventory",
    ),
    KnownError(
        r"BusyBox v\S+ .*multi-call binary\.\s+Usage: (\S+)",
        "{0} on the robot is busybox's, which lacks an option that fleet needs",
        "`sudo apt-get install {package}` on the robot",
    ),
    KnownError(
        _missing(_PACKAGED),
        "the command {0} is missing on the robot",
        "`sudo apt-get install {package}` on the robot",
        dict.fromkeys(
            _STARTING, "if a container needs it, install {package} in its image; else on the robot"
        ),
    ),
    KnownError(
        _missing(_WORD),
        "the command {0} is missing on the robot",
        "install the package that has it: `apt-cache search {0}` on the robot may find it",
        dict.fromkeys(_STARTING, "if a container needs it, install it in its image; else on the robot"),
    ),
)
