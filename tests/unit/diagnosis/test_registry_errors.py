from __future__ import annotations

import pytest

from fleet.diagnosis import explain

_DIGEST = f"sha256:{'2d' * 32}"
_HEAD = (
    f'Error response from daemon: failed to resolve reference "10.0.0.5:5000/robots/talker@{_DIGEST}": failed to do request: '
    f'Head "https://10.0.0.5:5000/v2/robots/talker/manifests/{_DIGEST}": '
)
_RESOLVE = f'Error response from daemon: failed to resolve reference "10.0.0.5:5000/talker@{_DIGEST}": '
_GET = 'Error response from daemon: Get "https://10.0.0.5:5000/v2/": '

# What Docker 20.10 and 26.1 (classic store: Get; containerd's: Head) say to `docker pull`.
PULLS = [
    (
        f'Error response from daemon: Get "http://127.0.0.1:40311/v2/talker/manifests/{_DIGEST}": EOF',
        "the robot lost the way to the images on this computer",
        "again",
    ),
    *(
        (f"{get}{says}", what, cure)
        for get in (_GET, _HEAD)
        for says, what, cure in (
            (
                "dial tcp: lookup reg.local on 127.0.0.11:53: no such host",
                "the robot does not know the host of the registry 10.0.0.5:5000",
                "getent hosts",
            ),
            (
                "dial tcp 10.0.0.5:5000: connect: connection refused",
                "the robot cannot reach the registry 10.0.0.5:5000",
                "check that it runs",
            ),
            (
                "tls: failed to verify certificate: x509: certificate signed by unknown authority",
                "the robot's Docker does not trust the certificate of the registry 10.0.0.5:5000",
                "ca:",
            ),
            (
                "x509: certificate has expired or is not yet valid: current time 2030-01-01T00:00:00Z is after",
                "the robot's Docker does not trust the certificate of the registry 10.0.0.5:5000 (x509: certificate has expired",
                "date -u",
            ),
            (
                "remote error: tls: bad certificate",
                "the registry 10.0.0.5:5000 refuses the robot's client certificate (bad certificate)",
                "client_key:",
            ),
            (
                "http: server gave HTTP response to HTTPS client",
                "the registry 10.0.0.5:5000 does not speak TLS",
                "use a certificate",
            ),
        )
    ),
    (
        f'Error response from daemon: Get "https://10.0.0.5:5000/v2/talker/manifests/{_DIGEST}": no basic auth credentials',
        "the registry 10.0.0.5:5000 does not let the robot pull",
        "docker login",
    ),
    (
        f"{_RESOLVE}pull access denied, repository does not exist or may require authorization: authorization failed: no basic auth credentials",
        "the registry 10.0.0.5:5000 does not let the robot pull",
        "docker login",
    ),
    (
        f"Error response from daemon: manifest for 10.0.0.5:5000/talker@{_DIGEST} not found: manifest unknown",
        "the registry does not have 10.0.0.5:5000/talker with this digest any more",
        "again",
    ),
    (
        f"{_RESOLVE}10.0.0.5:5000/talker@{_DIGEST}: not found",
        "the registry does not have 10.0.0.5:5000/talker with this digest any more",
        "again",
    ),
    (
        f"filesystem layer verification failed for digest {_DIGEST}",
        "a layer arrived damaged from the registry",
        "remove the image",
    ),
]


@pytest.mark.parametrize(("output", "what", "cure"), PULLS)
def test_what_docker_says_to_a_pull_is_understood(output: str, what: str, cure: str) -> None:
    """While `fab ship` runs."""
    said = explain.explain(output, verb="ship")
    assert said[0].startswith(what)
    assert cure in said[1]
