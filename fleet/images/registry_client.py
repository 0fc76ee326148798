"""How do images get into a registry for robots, and what may a robot use to pull them?

The protocol is "Pushing" of opencontainers/distribution-spec; the login is Docker's ("Token Authentication" of
distribution/distribution). Docker itself is not used for it: it packs layers anew, and takes its certificates from folders
that belong to root.
"""

from __future__ import annotations

import base64
import contextlib
import http.client
import json
import re
import socket
import ssl
import threading
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING
from urllib.parse import urlencode, urljoin, urlsplit

from fleet.errors import NotReady

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Mapping, Sequence

    from fleet.config.registry import Registry
    from fleet.images.layer import Blob

TIMEOUT = 30.0
"""Seconds without a byte after which a registry does not answer."""

_LOOPBACK = re.compile(r"(?:localhost|127\.[0-9.]+)(?::[0-9]+)?")
_MANIFESTS = (
    "application/vnd.oci.image.manifest.v1+json, application/vnd.oci.image.index.v1+json, "
    "application/vnd.docker.distribution.manifest.v2+json, application/vnd.docker.distribution.manifest.list.v2+json"
)
_TELLS = 2000  # characters of a registry's error that are looked at
_CURE_LOGIN = "`docker login` on this computer, or `user:` and `token:` of `registry:` in the inventory"


@dataclass(frozen=True)
class Login:
    """A user of a registry, and the password or token."""

    user: str
    password: str

    @property
    def basic(self) -> str:
        """Both as HTTP and Docker's config.json have them (RFC 7617)."""
        return base64.b64encode(f"{self.user}:{self.password}".encode()).decode()


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What a registry answers."""

    code: int
    headers: Mapping[str, str]
    body: bytes


class RegistryClient:
    """One registry; may be used from many threads. ``login`` finds the login, and is asked only if the registry wants one.

    All methods raise `NotReady` if the registry does not answer, is not the right one, refuses, or is full.
    """

    def __init__(self, registry: Registry, *, login: Callable[[], Login | None]) -> None:
        self.registry = registry
        self._find_login = login
        self._tokens: dict[str, str] = {}
        self._lock = threading.Lock()
        self._plain = bool(_LOOPBACK.fullmatch(registry.host))

    def has(self, path: str, kind: str, digest: str) -> bool:
        """Whether it has one of its ``blobs`` or ``manifests`` at the path of an image."""
        return self._ask("HEAD", path, f"{kind}/{digest}", expect=(200, 307, 404)).code != 404

    def push_blob(self, path: str, blob: Blob, content: IO[bytes]) -> None:
        """Upload the bytes of a blob."""
        begun = self._ask("POST", path, "blobs/uploads/", expect=(202,))
        place = begun.headers.get("location", "")
        separator = "&" if "?" in place else "?"
        target = f"{place}{separator}{urlencode({'digest': blob.digest})}"
        self._ask("PUT", path, target, body=content, size=blob.size, expect=(201,))

    def push_manifest(self, path: str, reference: str, manifest: bytes, media_type: str) -> None:
        """Store a manifest under its digest or a tag. The registry checks that it has all its blobs."""
        self._ask(
            "PUT",
            path,
            f"manifests/{reference}",
            body=manifest,
            size=len(manifest),
            media_type=media_type,
            expect=(201,),
        )

    def docker_config(self, paths: tuple[str, ...]) -> str:
        """The config.json with which a robot's Docker may pull from these paths; "" if the registry wants no login.

        Where the registry gives out tokens, it is one that may only pull, and only for some minutes.
        """
        key = " ".join(paths)
        self._tokens.pop(key, None)
        self._ask("HEAD", paths[0], "manifests/latest", expect=(200, 404), only_pull=paths)
        token = self._tokens.get(key, "")
        if not token:
            return ""
        scheme, _, value = token.partition(" ")
        auth = {"registrytoken" if scheme == "Bearer" else "auth": value}
        return json.dumps({"auths": {self.registry.host: auth}})

    def _ask(
        self,
        method: str,
        path: str,
        target: str,
        *,
        expect: tuple[int, ...],
        only_pull: tuple[str, ...] = (),
        body: IO[bytes] | bytes | None = None,
        size: int = 0,
        media_type: str = "application/octet-stream",
    ) -> Answer:
        """Ask about an image, log in if that is wanted, and return the answer if its code is one of those that are expected.

        The login is for pulling and pushing the image, or else for pulling those in ``only_pull``.
        """
        scheme = "http" if self._plain else "https"
        url = urljoin(f"{scheme}://{self.registry.host}/v2/{path}/", target)
        headers = {"Content-Type": media_type, "Content-Length": str(size)} if body is not None else {}
        headers |= {"Accept": _MANIFESTS, **({"Content-Length": "0"} if method == "POST" else {})}
        key = " ".join(only_pull) or f"{path} push"
        used = self._tokens.get(key)
        answer = self._request(method, url, headers | _authorization(used), body)
        if answer.code == 401:
            with self._lock:
                if self._tokens.get(key) == used:  # none yet, or it has expired
                    scopes = [f"repository:{one}:pull" for one in only_pull] or [
                        f"repository:{path}:pull,push"
                    ]
                    self._tokens[key] = self._log_in(answer, scopes)
            if body is not None and not isinstance(body, bytes):
                body.seek(0)
            answer = self._request(method, url, headers | _authorization(self._tokens[key]), body)
        if answer.code in expect:
            return answer
        raise self._refusal(answer, path)

    def _request(
        self, method: str, url: str, headers: Mapping[str, str], body: IO[bytes] | bytes | None
    ) -> Answer:
        parts = urlsplit(url)
        with self._explained(parts.netloc):
            if parts.scheme == "http" and _LOOPBACK.fullmatch(parts.netloc):
                connection = http.client.HTTPConnection(parts.netloc, timeout=TIMEOUT)
            elif parts.scheme == "https":
                connection = http.client.HTTPSConnection(
                    parts.netloc, timeout=TIMEOUT, context=self._context()
                )
            else:
                raise NotReady(f"the registry {self.registry.host} leads to {url}, which is not encrypted")
            with contextlib.closing(connection):
                with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # its answer tells why
                    connection.request(
                        method, f"{parts.path}?{parts.query}", body=body, headers=dict(headers)
                    )
                found = connection.getresponse()
                names = {name.lower(): value for name, value in found.getheaders()}
                return Answer(code=found.status, headers=names, body=found.read())

    def _context(self) -> ssl.SSLContext:
        context = ssl.create_default_context()
        registry = self.registry
        if registry.ca:
            context.load_verify_locations(registry.ca)
        if registry.client_cert:
            context.load_cert_chain(registry.client_cert, registry.client_key)
        return context

    def _log_in(self, answer: Answer, scopes: Sequence[str]) -> str:
        """The ``Authorization`` that the registry's answer asks for."""
        scheme, _, rest = answer.headers.get("www-authenticate", "").partition(" ")
        if scheme.lower() != "bearer":
            return f"Basic {self._login().basic}"
        wants = dict(re.findall(r'(\w+)="([^"]*)"', rest))
        query = [("service", wants.get("service", "")), *(("scope", scope) for scope in scopes)]
        login = self._find_login()
        headers = {"Authorization": f"Basic {login.basic}"} if login else {}
        given = self._request("GET", f"{wants.get('realm', '')}?{urlencode(query)}", headers, None)
        with contextlib.suppress(ValueError, TypeError, AttributeError):
            described = json.loads(given.body)
            if token := described.get("token") or described.get("access_token"):
                return f"Bearer {token}"
        raise NotReady(f"the registry {self.registry.host} refuses the login", cure=_CURE_LOGIN)

    def _login(self) -> Login:
        if login := self._find_login():
            return login
        raise NotReady(f"the registry {self.registry.host} wants a login", cure=_CURE_LOGIN)

    def _refusal(self, answer: Answer, path: str) -> NotReady:
        said = answer.body[:_TELLS].decode(errors="replace")
        where = f"the registry {self.registry.host}"
        if answer.code in (401, 403):
            return NotReady(f"{where} does not let this login use {path}", cure=_CURE_LOGIN)
        if answer.code in (413, 507) or "no space left" in said or '"Err":28' in said:
            return NotReady(f"{where} is full", cure="free some disk there, then run the same command again")
        if answer.code == 405:
            return NotReady(f"{where} is read-only", cure="push to another address, or let it be written to")
        words = " ".join(re.sub(r"[^ -~]", " ", said).split())[:200]
        what = f"{where} answers {answer.code}{f' ({words})' if words else ''}"
        return NotReady(what, cure="look into its log")

    @contextlib.contextmanager
    def _explained(self, host: str) -> Generator[None]:
        """Turn errors of the connection into ours."""
        where = f"the registry {host}"
        try:
            yield
        except ssl.SSLCertVerificationError as problem:
            what = f"the certificate of {where} is not trusted: {problem.verify_message}"
            raise NotReady(
                what, cure="name the one that signed it: `registry: {ca: ...}` in the inventory"
            ) from problem
        except ssl.SSLError as problem:
            raise _tls(where, problem, own=bool(self.registry.client_cert)) from problem
        except socket.gaierror as problem:
            what = f"this computer does not know the host of {where}"
            raise NotReady(what, cure="correct `registry: {address: ...}` in the inventory") from problem
        except TimeoutError as problem:
            what = f"{where} does not answer within {TIMEOUT:.0f} s"
            raise NotReady(what, cure="check that it runs, and the network") from problem
        except (OSError, http.client.HTTPException) as problem:
            reason = getattr(problem, "strerror", "") or str(problem) or type(problem).__name__
            raise NotReady(
                f"{where} cannot be reached: {reason}", cure="check that it runs, and its address"
            ) from problem


def _authorization(token: str | None) -> dict[str, str]:
    return {"Authorization": token} if token else {}


def _tls(where: str, problem: ssl.SSLError, *, own: bool) -> NotReady:
    """The error for a TLS connection that failed. OpenSSL names the reason."""
    reason = problem.reason or str(problem)
    if "WRONG_VERSION" in reason or "HTTP_REQUEST" in reason:
        return NotReady(f"{where} does not speak TLS", cure="let it use a certificate: robots need one too")
    if "CERTIFICATE" in reason or "UNKNOWN_CA" in reason or "HANDSHAKE_FAILURE" in reason:
        what = f"{where} refuses the client certificate" if own else f"{where} wants a client certificate"
        return NotReady(what, cure="correct `client_cert:` and `client_key:` of `registry:` in the inventory")
    if "KEY_VALUES_MISMATCH" in reason or "PEM" in reason or "NO_START_LINE" in reason:
        return NotReady(
            "the certificates under `registry:` in the inventory cannot be read, or do not fit each other",
            cure="each must be a PEM file, and client_key the key of client_cert",
        )
    if "EOF" in reason:
        what = f"{where} breaks off the TLS connection"
        return NotReady(what, cure="see its log: it may want a client certificate, or another one")
    return NotReady(f"the TLS connection to {where} failed: {reason.lower().replace('_', ' ')}")
