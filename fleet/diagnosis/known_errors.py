"""Which words of which tool mean what to a person, and what cures it?

What Docker, Compose, apt, dpkg, sudo, curl and shells print when they fail. Data only; `fleet.diagnosis.explain` reads it.
"""

from __future__ import annotations

from typing import NamedTuple


class KnownError(NamedTuple):
    """``what`` and ``cure`` may name the groups that matched in ``pattern``: {0} is the first one that took part."""

    pattern: str
    what: str
    cure: str


_PROVISION = "`fab provision` cures that"
_SHIP = "run the same command again: what arrived whole is not sent again"
_INTERNET = "see that it has internet: `ping -c 1 deb.debian.org` there"
_AGAIN = (
    "wait until it is done (the updates after a first boot take minutes), then run the same command again"
)
_NAMES = r"(?:[A-Za-z0-9][A-Za-z0-9.-]*)"

# The first sign that matches counts: causes stand before the errors that follow from them.
KNOWN_ERRORS = (
    # The robot itself.
    KnownError(
        r"(?i)no space left on device|You don't have enough free space in|disk quota exceeded",
        "its disk is full",
        "`df -h` there shows which; `sudo apt-get clean` and `docker image prune` free some",
    ),
    KnownError(
        r"(?i)read-only file system",
        "a file system has become read-only, as it does when an SD card fails",
        "reboot it; if it comes back, replace the SD card (`dmesg | grep -i mmc` there tells)",
    ),
    KnownError(
        r"(?i)input/output error",
        "its disk does not read or write any more",
        "replace the SD card (`dmesg | grep -i mmc` there tells)",
    ),
    KnownError(
        r"(?i)cannot allocate memory|out of memory|signal: killed",
        "it ran out of memory",
        "`free -h` there shows who has it; a smaller stack or more swap helps",
    ),
    KnownError(
        r"(?i)cannot set date", "its clock cannot be set", "`timedatectl` there shows who keeps the clock"
    ),
    KnownError(
        r"is not valid yet|certificate is not yet valid|Not live until",
        "its clock is behind, so that nothing it downloads is believed",
        "`fab provision` sets the clock",
    ),
    KnownError(
        r"Release file for (\S+) is expired",
        "its clock is ahead, or nobody cares for {0} any more",
        "`fab provision` sets the clock",
    ),
    KnownError(
        r"^(\S+) is shipping to this robot",
        "{0} is shipping to it just now",
        "wait until that is done, then run the same command again",
    ),
    KnownError(
        r"cannot (?:create|remove|move) .*'?\.fleet\b.*: Permission denied",
        "something in its ~/.fleet belongs to another user",
        "`sudo chown -R $(id -un): ~/.fleet` there; Docker makes what it mounts anew as root when it is gone",
    ),
    # sudo.
    KnownError(
        r"sudo: (?:a password is required|a terminal is required|no tty present|sorry, you must have a tty)",
        "sudo asks this login for a password",
        "`sudo visudo -f /etc/sudoers.d/010_nopasswd` there, with the line: LOGIN ALL=(ALL) NOPASSWD: ALL",
    ),
    KnownError(
        r"(\S+) is not in the sudoers file|user (\S+) (?:may not run sudo|is not allowed to execute)",
        "{0} may not use sudo",
        "add it there, as root: `usermod -aG sudo {0}`",
    ),
    # A missing image: Docker then asks a registry, which fails for reasons that only mislead.
    KnownError(
        r"Unable to find image '([^']+)' locally|pull access denied for ([^, ]+)|No such image: (\S+)|manifest for (\S+) not found"
        r"|image (?:with reference )?\"?([^\s\"]+)\"? was (?:found but|not found)",
        "the image {0} is not there",
        "`fab ship` sends it",
    ),
    # apt and dpkg.
    KnownError(
        r"It is held by process \d+ \(([^)]+)\)|lock was locked by (\S+) process with pid",
        "another program there uses apt ({0})",
        _AGAIN,
    ),
    KnownError(
        r"Could not get lock|Unable to (?:lock (?:directory|the)|acquire the dpkg frontend lock)",
        "another program there uses apt",
        _AGAIN,
    ),
    KnownError(r"dpkg was interrupted", "dpkg was stopped in the middle of its work", _PROVISION),
    KnownError(
        rf"Temporary failure resolving '([^']+)'|Could not resolve host:? '?({_NAMES})|lookup (\S+)(?: on \S+)?: ",
        "it cannot find {0}: no DNS, or no internet",
        _INTERNET,
    ),
    KnownError(
        r"Temporary failure in name resolution", "it cannot find names: no DNS, or no internet", _INTERNET
    ),
    KnownError(
        rf"(?:Could not|Unable to) connect to ({_NAMES})|Cannot initiate the connection to ({_NAMES})"
        rf"|Failed to connect to ({_NAMES}) port",
        "it cannot reach {0}",
        _INTERNET,
    ),
    KnownError(r"curl: \(28\)", "a download took too long", _INTERNET),
    KnownError(
        r"trying to overwrite '[^']+', which is also in package (\S+)",
        "its package {0} clashes with the new one",
        "`sudo apt-get remove {0}` there, then run the same command again",
    ),
    KnownError(
        r"^dpkg: error processing (?:archive|package) (?:\S*/)?(\S+) \(.*\):\n (.+)",
        "dpkg could not install {0}: {1}",
        "`sudo dpkg --configure -a` there shows it again",
    ),
    KnownError(
        r"ERROR: '([^']+)' not found amongst apt-cache madison results",
        "there is no Docker {0} for its system",
        "pin another version in the inventory: `apt-cache madison docker-ce` there lists them",
    ),
    KnownError(
        r"ERROR: Unsupported (distribution|operating system) '([^']+)'",
        "Docker's script does not know its {0}, {1}",
        "install Docker there by hand; `fab provision` does the rest",
    ),
    KnownError(
        r"no package of this system brings the Compose plugin",
        "no package of its system brings the Compose plugin",
        "",
    ),
    KnownError(
        r"Unable to locate package (\S+)|Package '([^']+)' has no installation candidate",
        "its package sources do not have {0}",
        "`sudo apt-get update` there shows whether they work",
    ),
    KnownError(
        r"The repository '([^']+)' (?:does not have a Release file|is not signed|is no longer signed)",
        "apt does not accept the package source {0}",
        "mend or remove it there, in /etc/apt/sources.list.d/",
    ),
    KnownError(
        r"Hash Sum mismatch|Failed to fetch \S+ +404",
        "the package archive has changed under it",
        "run the same command again",
    ),
    KnownError(
        r"have unmet dependencies|you have held broken packages|Unmet dependencies",
        "apt cannot make its packages fit together",
        "`sudo apt-get --fix-broken install` there",
    ),
    # Docker.
    KnownError(
        r"(?i)permission denied while trying to connect to the Docker|docker\.sock: connect: permission denied",
        "this login may not use Docker",
        _PROVISION,
    ),
    KnownError(
        r"unable to configure the Docker daemon with file \S+: (.+)",
        "Docker does not understand its configuration: {0}",
        "mend /etc/docker/daemon.json there, then `fab provision`",
    ),
    KnownError(
        r"(?i)iptables.*(?:No chain/target/match|does not exist|can't initialize)|Failed to Setup IP tables",
        "Docker cannot set up the network: its kernel lacks iptables modules",
        "reboot it: an update may have replaced the running kernel's modules",
    ),
    KnownError(
        r"(?i)Cannot connect to the Docker daemon|failed to connect to the docker API",
        "Docker is not running",
        f"{_PROVISION}; `journalctl -u docker` there tells why",
    ),
    KnownError(
        r"Job for docker\.service failed|docker\.service: (?:Start request repeated|Failed with result)",
        "Docker does not start",
        "`journalctl -u docker` there tells why",
    ),
    KnownError(
        r"Unit \S*docker\.service is masked",
        "Docker's service is masked",
        "`sudo systemctl unmask docker` there",
    ),
    KnownError(
        r"docker: (?:command )?not found|failed to run command .docker.|sudo: docker: command not found"
        r"|Unit (?:file )?docker\.service (?:does not exist|not found|could not be found)",
        "Docker is not installed",
        _PROVISION,
    ),
    KnownError(
        # Without the plugin, `docker` takes Compose's options for its own.
        r"'compose' is not a docker command|unknown (?:docker )?command: \"?(?:docker )?compose"
        r"|unknown (?:shorthand )?flag: .*\s+(?:See 'docker --help'|Usage: +docker \[OPTIONS\])",
        "Docker's Compose plugin is missing",
        _PROVISION,
    ),
    KnownError(
        r"(?i)exec format error",
        "a program is for another processor than its own",
        "see `platform` in the inventory, then `fab build` and `fab ship`",
    ),
    KnownError(
        r"(?i)no matching manifest for (\S+)",
        "there is no such image for {0}",
        "see `platform` in the inventory, then `fab build` and `fab ship`",
    ),
    KnownError(
        r"(?i)invalid diffID for layer|wrong diff id|layers from manifest don't match|unexpected EOF|invalid tar header",
        "the image arrived damaged or cut off",
        _SHIP,
    ),
    KnownError(
        r"Bind for \S*:(\d+) failed|failed to bind host port (?:for )?\S*?:(\d+)[:/]|(?:listen|bind) \w+ \S*:(\d+): bind: address already in use|port is already allocated()",
        "port {0} is taken there",
        "`sudo ss -ltnp` there shows by whom",
    ),
    KnownError(r"(?i)address already in use", "a port is taken there", "`sudo ss -ltnp` there shows by whom"),
    KnownError(
        r'container name "/?([^"]+)" is already in use',
        "another container there is called {0}",
        "`docker rm --force {0}` there, if nobody needs it",
    ),
    KnownError(
        r'adding custom device "([^"]+)": no such file|error gathering device information.*"([^"]+)"',
        "the device {0} is not there",
        "see that it is plugged in: `ls -l {0}` there",
    ),
    KnownError(
        r"bind source path does not exist: (\S+?)\.?(?:\s|$)",
        "{0} is not there, and a container needs it",
        "create it there, or list it under `files:` in the inventory",
    ),
    KnownError(
        r'could not select device driver "([^"]*)"|unknown or invalid runtime name: (\S+)',
        "its Docker has no runtime {0}",
        "on a Jetson, install nvidia-container-toolkit there",
    ),
    KnownError(
        r"(?i)memory (?:controller|cgroup).*(?:disabled|not (?:found|available|enabled))|cgroup.*memory.*no such file",
        "its kernel has memory limits switched off",
        "add `cgroup_enable=memory` to the line in /boot/firmware/cmdline.txt there, and reboot",
    ),
    KnownError(
        r'exec: "([^"]+)": (?:executable file not found|stat|permission denied)|^exec (\S+): no such file',
        "the image cannot run {0}",
        "mend the service's `command` or the image's entry point",
    ),
    KnownError(
        r"(?i)device or resource busy", "something there is in use", "reboot it if that does not pass"
    ),
    # Compose.
    KnownError(
        r"required variable (\S+) is missing a value: *(.*)",
        "the stack needs the variable {0} ({1})",
        "set it under `environment:` in the inventory",
    ),
    KnownError(
        r"no configuration file provided|cannot change directory to .*releases/([\w.-]*)|stat \S*compose\.yaml: no such file",
        "the release is not there",
        "`fab ship` writes it",
    ),
    KnownError(
        r"(yaml: .+)|validating \S+: (.+)|(?:parsing \S+: |)(services\.\S+ .+)|(service \"[^\"]+\" .*undefined.*)",
        "the Compose file is not valid: {0}",
        "mend it, and run the same command again",
    ),
    KnownError(r"(container \S+ is unhealthy)", "{0}", "`fab logs` shows what it says"),
    KnownError(
        r"container (\S+) exited \((\d+)\)",
        "container {0} ended with code {1}",
        "`fab logs` shows what it said",
    ),
    KnownError(
        r"unknown (?:shorthand )?flag: (.+)",
        "its Docker does not know {0}: it is too old",
        "update it there: `sudo apt-get update && sudo apt-get upgrade`",
    ),
    # Shells.
    KnownError(
        r"failed to run command .([\w./-]+).: No such file|sh: \d+: ([\w./-]+): not found|(\S+): command not found",
        "{0} is not installed",
        "",
    ),
)
