"""Which errors of a robot's Docker that pulls from a registry do we know?

This is data only, a part of `fleet.diagnosis.known_errors`.
"""

from __future__ import annotations

from fleet.diagnosis.known_error import KnownError

_URL = r'"https?://([^/"]+)/v2/[^"]*": '
_UNREACHABLE = (
    r"connection refused|connection reset|i/o timeout|no route to host|network is unreachable|EOF"
    r"|Client\.Timeout|deadline exceeded|server misbehaving"
)
_AGAIN = "run the same command again"
_HERE: dict[str, str] = {
    "provision": "correct `ca:`, `client_cert:` and `client_key:` of `registry:` in the inventory"
}
_LOGIN = "check the login: `docker login` on this computer, or `user:` and `token:` of `registry:` in the inventory"

# The first match counts, so causes stand before the errors that follow from them.
REGISTRY_ERRORS = (
    KnownError(
        rf'"https?://(127\.[0-9.]+:\d+)/v2/[^"]*": .*(?:{_UNREACHABLE})',
        "the robot lost the way to the images on this computer",
        _AGAIN,
    ),
    KnownError(
        rf"{_URL}.*no such host",
        "the robot does not know the host of the registry {0}",
        "correct `registry: {{address: ...}}` in the inventory, or the robot's DNS: `getent hosts NAME` on it",
    ),
    KnownError(
        rf"{_URL}.*(?:{_UNREACHABLE})",
        "the robot cannot reach the registry {0}",
        "check that it runs, and that the robot's network leads to it",
    ),
    KnownError(
        rf"{_URL}.*x509: certificate signed by unknown authority",
        "the robot's Docker does not trust the certificate of the registry {0}",
        "name the certificate that signed it as `registry: {{ca: ...}}` in the inventory, then `fab provision`",
        _HERE,
    ),
    KnownError(
        rf"{_URL}.*(x509: .+)",
        "the robot's Docker does not trust the certificate of the registry {0} ({1})",
        "give the registry a certificate for this address and time; compare `date -u` on the robot",
    ),
    KnownError(
        rf"{_URL}.*remote error: tls: (.*certificate.*|handshake failure)",
        "the registry {0} refuses the robot's client certificate ({1})",
        "correct `client_cert:` and `client_key:` of `registry:` in the inventory, then `fab provision`",
        _HERE,
    ),
    KnownError(
        rf"{_URL}.*server gave HTTP response to HTTPS client",
        "the registry {0} does not speak TLS, and Docker wants it",
        "let the registry use a certificate",
    ),
    KnownError(
        rf"{_URL}.*(?:no basic auth credentials|unauthorized|denied)",
        "the registry {0} does not let the robot pull",
        _LOGIN,
    ),
    KnownError(
        r"failed to resolve reference \"([^/\"]+)/[^\"]*\": .*(?:authorization failed|unauthorized|denied)",
        "the registry {0} does not let the robot pull",
        _LOGIN,
    ),
    KnownError(
        r"manifest for (\S+)@sha256:\S+ not found|failed to resolve reference \"([^\"@]+)@sha256:[^\"]+\": .*not found",
        "the registry does not have {0} with this digest any more",
        f"{_AGAIN}, which pushes it again",
    ),
    KnownError(
        r"layer verification failed for digest|failed commit on ref .*unexpected commit (?:digest|size)",
        "a layer arrived damaged from the registry",
        f"{_AGAIN}; if the error stays, remove the image from the registry",
    ),
)
