"""A registry in a few lines, on loopback or with TLS, that can ask for a login, be full, or lose things."""

from __future__ import annotations

import base64
import hashlib
import http.server
import json
import ssl
import subprocess
import threading
from typing import TYPE_CHECKING, Any, Self
from urllib.parse import parse_qs, urlsplit

from fleet.images.registry_http import Handler

if TYPE_CHECKING:
    from pathlib import Path


class TestRegistry:
    """``blobs`` by digest, ``manifests`` by path and reference; ``scopes`` are those of the tokens that were given out."""

    __test__ = False

    def __init__(self, *, auth: str = "", full: bool = False, tls: ssl.SSLContext | None = None) -> None:
        self.blobs: dict[str, bytes] = {}
        self.manifests: dict[tuple[str, str], bytes] = {}
        self.scopes: list[list[str]] = []
        self.asked: list[tuple[str, str]] = []
        self.tokens: set[str] = set()
        self.auth = auth
        self.full = full
        handler = type("Handler", (_Handler,), {"registry": self})
        self._server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
        self._server.daemon_threads = True
        self._server.block_on_close = False
        self._server.handle_error = lambda *_: None  # type: ignore[method-assign]
        if tls:
            self._server.socket = tls.wrap_socket(self._server.socket, server_side=True)
        self.port = self._server.server_address[1]

    def __enter__(self) -> Self:
        threading.Thread(target=self._server.serve_forever, args=(0.02,), daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()


class _Handler(Handler):
    registry: TestRegistry

    def do_HEAD(self) -> None:  # noqa: N802
        self._do()

    do_GET = do_POST = do_PUT = do_HEAD  # noqa: N815

    def _do(self) -> None:
        body, one = b"".join(self.body()), self.registry
        url = urlsplit(self.path)
        one.asked.append((self.command, self.path))
        if url.path == "/token":
            self._give_token(parse_qs(url.query)["scope"])
        elif one.auth and not self._may():
            port = one.port
            wants = {
                "basic": 'Basic realm="test"',
                "bearer": f'Bearer realm="http://127.0.0.1:{port}/token",service="test"',
            }
            self.answer(401, {"WWW-Authenticate": wants[one.auth]})
        else:
            self._answer(url.path.removeprefix("/v2/"), parse_qs(url.query), body)

    def _give_token(self, scopes: list[str]) -> None:
        good = self.headers.get("Authorization") == f"Basic {base64.b64encode(b'tim:secret').decode()}"
        self.registry.scopes.append(scopes)
        token = f"token-{len(self.registry.scopes)}"
        self.registry.tokens |= {token} if good else set()
        data = json.dumps({"token": token} if good else {"errors": []}).encode()
        self.answer(200 if good else 401, {"Content-Length": str(len(data))})
        self.wfile.write(data)

    def _may(self) -> bool:
        kind, _, value = self.headers.get("Authorization", "").partition(" ")
        basic = base64.b64encode(b"tim:secret").decode()
        return value == basic if kind == "Basic" else value in self.registry.tokens

    def _answer(self, where: str, query: dict[str, list[str]], body: bytes) -> None:
        one = self.registry
        path, _, rest = where.rpartition("/blobs/") if "/blobs/" in where else where.rpartition("/manifests/")
        there: Any = one.blobs.get(rest) if "/blobs/" in where else one.manifests.get((path, rest))
        if self.command in ("HEAD", "GET"):
            self.answer(200 if there is not None else 404)
        elif self.command == "POST":
            self.answer(202, {"Location": f"/v2/{path}/blobs/uploads/1?state=x"})
        elif one.full:
            data = (
                b'{"errors":[{"code":"UNKNOWN","message":"unknown error","detail":{"Op":"write","Err":28}}]}'
            )
            self.answer(500, {"Content-Length": str(len(data))})
            self.wfile.write(data)
        elif "/blobs/" in where:
            digest = f"sha256:{hashlib.sha256(body).hexdigest()}"
            if query["digest"] == [digest]:
                one.blobs[digest] = body
            self.answer(201 if query["digest"] == [digest] else 400)
        else:
            one.manifests[path, rest] = body
            one.manifests[path, f"sha256:{hashlib.sha256(body).hexdigest()}"] = body
            self.answer(201)


def make_certificates(folder: Path, *names: str, address: str = "127.0.0.1") -> None:
    """A ``ca.crt`` in a folder, and for each name ``NAME.crt`` and ``NAME.key`` that it has signed."""
    folder.mkdir(parents=True, exist_ok=True)
    new = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes")

    def openssl(*argv: str) -> None:
        subprocess.run(("openssl", *argv), cwd=folder, check=True, capture_output=True)

    openssl("req", "-x509", *new, "-keyout", "ca.key", "-out", "ca.crt", "-days", "9", "-subj", "/CN=test CA")
    (folder / "names").write_text(f"subjectAltName=IP:{address}\n")
    for name in names:
        openssl("req", *new, "-keyout", f"{name}.key", "-out", f"{name}.csr", "-subj", f"/CN={name}")
        sign = ("-CA", "ca.crt", "-CAkey", "ca.key", "-CAcreateserial", "-days", "9", "-extfile", "names")
        openssl("x509", "-req", "-in", f"{name}.csr", *sign, "-out", f"{name}.crt")


def server_tls(folder: Path, *, clients: bool) -> ssl.SSLContext:
    """TLS as a registry with the certificate ``server`` speaks it; with ``clients`` only to those that have one too."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(folder / "server.crt", folder / "server.key")
    if clients:
        # With 1.3 the client has sent its request already, and a closed socket may be faster than the reason.
        context.maximum_version = ssl.TLSVersion.TLSv1_2
        context.load_verify_locations(folder / "ca.crt")
        context.verify_mode = ssl.CERT_REQUIRED
    return context
