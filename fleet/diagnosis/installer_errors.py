"""Which errors of apt, dpkg, curl and Docker's script do we know?

This is data only, a part of `fleet.diagnosis.known_errors`.
"""

from __future__ import annotations

from fleet.diagnosis.known_error import KnownError

_PROVISION = "run `fab provision`"
_INTERNET = "check the robot's internet connection: `ping -c 1 deb.debian.org` on the robot"
_AGAIN = (
    "wait until it has finished (updates after the first boot take minutes), then run the same command again"
)
_ANOTHER_SERVER = (
    "run the same command again in some minutes; if the error stays, name another server in the robot's "
    "/etc/apt/sources.list, or check what filters its network"
)
_COMPOSE_BY_HAND = "https://docs.docker.com/compose/install/linux"
_DOCKERS = r"docker-ce[\w-]*|containerd\.io|docker-(?:compose|buildx|model)-plugin"
_BY_HAND = (
    "https://docs.docker.com/engine/install lists the systems that Docker supports; if the robot's is not among them, "
    "install the system's own Docker (`sudo apt-get install docker.io`) and run the same command again for the rest"
)
_NAMES = r"(?:[A-Za-z0-9][A-Za-z0-9.-]*)"

# The first match counts, so causes stand before the errors that follow from them.
INSTALLER_ERRORS = (
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
    KnownError(
        r"dpkg was interrupted",
        "dpkg was interrupted while it worked",
        _PROVISION,
        {"provision": "`sudo dpkg --configure -a` on the robot completes its work, or shows why it cannot"},
    ),
    KnownError(
        rf"Temporary failure resolving '([^']+)'|Could not resolve(?: host:?)? '?({_NAMES})|lookup (\S+)(?: on \S+)?: ",
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
        "set another `version:` under `docker:` in the inventory, or none for the newest; "
        "https://download.docker.com/linux/ lists those of each system",
    ),
    KnownError(
        r"ERROR: Unsupported (distribution|operating system) '([^']+)'",
        "Docker's install script does not support the robot's {0}, {1}",
        "install Docker on the robot by hand (https://docs.docker.com/engine/install), then run `fab provision` for the rest",
        {
            "provision": "install Docker on the robot by hand (https://docs.docker.com/engine/install), then run the same "
            "command again for the rest"
        },
    ),
    KnownError(
        r"no package of this system brings the Compose plugin",
        "the robot's system has no package with the Compose plugin",
        f"install it by hand ({_COMPOSE_BY_HAND}); or remove Docker on the robot (its containers stop, images stay), and run "
        "the same command again: Docker's own packages have it",
    ),
    KnownError(
        rf"Failed to fetch \w+://({_NAMES})\S* +(?:Connection failed|Connection timed out|Could not wait for server)"
        rf"|^package server (.+?) (?:sends nothing|does not answer)"
        rf"|curl -\S+ \"?\w+://({_NAMES})[^\n]*\n(?:.*\n)?.*curl: \(28\)",
        "the server {0} does not answer",
        _ANOTHER_SERVER,
    ),
    KnownError(r"curl: \(28\)", "a download took too long", _INTERNET),
    KnownError(
        rf"Unable to locate package ({_DOCKERS})|Package '({_DOCKERS})' has no installation candidate",
        "Docker's package server has no {0} for the robot's system",
        _BY_HAND,
    ),
    KnownError(
        r"The repository '(\S*download\.docker\.com/[^']+)' (?:does not have a Release file|is not signed|is no longer signed)",
        "Docker's package server has no packages for the robot's system ({0})",
        _BY_HAND,
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
        r"Hash Sum mismatch",
        "the package archive changed during the download",
        "run the same command again",
    ),
    KnownError(
        r"Failed to fetch \w+://([^/\s]+)\S* +404",
        "the package server {0} no longer has a file that the robot's package lists name",
        "`sudo apt-get update` on the robot, then run the same command again",
    ),
    KnownError(
        r"Failed to fetch \w+://([^/\s]+)\S* +(5\d\d)",
        "the package server {0} answers {1}: it is overloaded or down",
        _ANOTHER_SERVER,
    ),
    KnownError(
        r"curl -\S+ \"?\w+://([^/\"\s]+)[^\n]*\n(?:.*\n)?.*curl: \(22\).*error: (4\d\d)",
        "{0} answers the download with {1}: it does not have the file",
        _BY_HAND,
    ),
    KnownError(
        r"curl: \(22\).*error: (\d+)",
        "a server answers the robot's download with {0}",
        "run the same command again in some minutes; if the error stays, look at what Docker's script downloads",
    ),
    KnownError(
        r"have unmet dependencies|you have held broken packages|Unmet dependencies",
        "apt cannot resolve the dependencies of the robot's packages",
        "`sudo apt-get --fix-broken install` on the robot",
    ),
)
