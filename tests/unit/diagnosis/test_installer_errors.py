from __future__ import annotations

import pytest

from fleet.diagnosis import explain

# During `fab provision`: apt 2.6, curl 7.88, Docker's script of 2025, apt_compose.sh.
INSTALLERS = [
    (
        "E: Failed to fetch http://deb.debian.org/debian/pool/main/x/x_1_arm64.deb  Hash Sum mismatch",
        "the package archive changed during the download",
        "again",
    ),
    (
        "E: Failed to fetch http://deb.debian.org/debian/pool/main/x/x_1_arm64.deb  404  Not Found [IP: 151.101.2.132 80]",
        "the package server deb.debian.org no longer has a file that the robot's package lists name",
        "apt-get update",
    ),
    (
        "E: Failed to fetch http://deb.debian.org/debian/dists/trixie/InRelease  503  Service Unavailable [IP: 1.2.3.4 80]",
        "the package server deb.debian.org answers 503: it is overloaded or down",
        "in some minutes",
    ),
    (
        (
            '+ sh -c curl -fsSL "https://download.docker.com/linux/debian/gpg" -o /etc/apt/keyrings/docker.asc\n'
            "curl: (22) The requested URL returned error: 404"
        ),
        "download.docker.com answers the download with 404",
        "docker.io",
    ),
    *(
        (output, "the server download.docker.com does not answer", "in some minutes")
        for output in (
            (
                "W: Failed to fetch https://download.docker.com/linux/debian/dists/trixie/InRelease  Could not wait for server"
                " fd - select (11: Resource temporarily unavailable) [IP: 1.2.3.4 443]\nW: Some index files failed to download."
                "\nE: Unable to locate package docker-ce"
            ),
            "W: Failed to fetch http://download.docker.com/x/InRelease  Connection failed [IP: 1.2.3.4 80]",
            "W: Failed to fetch http://download.docker.com/x/InRelease  Connection timed out [IP: 1.2.3.4 80]",
            (
                '+ sh -c curl -fsSL "https://download.docker.com/linux/debian/gpg" -o /etc/apt/keyrings/docker.asc\n'
                "curl: (28) Operation too slow. Less than 1 bytes/sec transferred the last 20 seconds"
            ),
            "now: working, 15 s so far\npackage server download.docker.com sends nothing for 180 s",
        )
    ),
    (
        "E: Failed to fetch http://deb.debian.org/debian/dists/x/InRelease  Could not resolve 'deb.debian.org'",
        "the robot cannot resolve deb.debian.org",
        "ping",
    ),
    (
        "curl: (22) The requested URL returned error: 503",
        "a server answers the robot's download with 503",
        "in some minutes",
    ),
    (
        "E: Unable to locate package docker-ce-cli",
        "Docker's package server has no docker-ce-cli for the robot's system",
        "https://docs.docker.com/engine/install",
    ),
    (
        "E: Package 'docker-compose-plugin' has no installation candidate",
        "Docker's package server has no docker-compose-plugin",
        "docker.io",
    ),
    (
        "E: The repository 'https://download.docker.com/linux/debian forky Release' does not have a Release file.",
        "Docker's package server has no packages for the robot's system (https://download.docker.com/linux/debian forky",
        "docker.io",
    ),
    (
        "no package of this system brings the Compose plugin",
        "the robot's system has no package with the Compose plugin",
        "https://docs.docker.com/compose/install/linux",
    ),
    (
        "ERROR: Unsupported distribution 'alpine'",
        "Docker's install script does not support the robot's distribution, alpine",
        "by hand",
    ),
]


@pytest.mark.parametrize(("output", "what", "cure"), INSTALLERS, ids=[what for _, what, _ in INSTALLERS])
def test_what_installers_say_is_understood(output: str, what: str, cure: str) -> None:
    """While `fab provision` runs, no cure sends the user to it."""
    said = explain.explain(output, verb="provision")
    assert said[0].startswith(what)
    assert cure in said[1]
    assert "fab provision" not in said[1]
