"""Proxies with the files of deploy/, unchanged except for names, ports and folders."""

from __future__ import annotations

import contextlib
import http.client
import os
import re
import shutil
import socket
import ssl
import subprocess
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.support.ports import kept_port
from tests.support.server.certificates import make_certificate
from tests.support.waiting import BOUND_S, wait_until

DEPLOY = Path(__file__).parents[2] / "deploy"


def find_program(name: str) -> str | None:
    """Path of the program; Debian installs nginx in a folder that only root's PATH has."""
    return shutil.which(name) or shutil.which(name, path="/usr/sbin:/sbin")


def need(proxy: str) -> None:
    """Skips the test unless the proxy is installed."""
    if find_program(proxy) is None:
        pytest.skip(f"{proxy} is not installed")


def replaced(text: str, changes: Mapping[str, str]) -> str:
    """`text` with every key, a regular expression, replaced; each must match."""
    for pattern, new in changes.items():
        plain = new.replace("\\", r"\\")  # backslashes in it are literal
        text, count = re.subn(pattern, plain, text, flags=re.MULTILINE)
        assert count, f"{pattern} is not in the file any more"
    return text


@dataclass(frozen=True)
class Proxy:
    """A running proxy in front of a server."""

    port: int
    tls: bool

    def connect(self, timeout_s: float = BOUND_S) -> http.client.HTTPConnection:
        if not self.tls:
            return http.client.HTTPConnection("127.0.0.1", self.port, timeout=timeout_s)
        context = ssl._create_unverified_context()  # a certificate of the test
        return http.client.HTTPSConnection(
            "127.0.0.1", self.port, timeout=timeout_s, context=context
        )

    def ask(
        self,
        path: str,
        headers: Mapping[str, str] | None = None,
        method: str = "GET",
        body: bytes | None = None,
    ) -> tuple[int, http.client.HTTPMessage, bytes]:
        """Status, headers and body."""
        connection = self.connect()
        try:
            connection.request(method, path, body, dict(headers or {}))
            response = connection.getresponse()
            return response.status, response.headers, response.read()
        finally:
            connection.close()


Start = Callable[..., contextlib.AbstractContextManager[Proxy]]


@contextlib.contextmanager
def started(command: list[str], proxy: Proxy, log: Path, **more: str) -> Iterator[Proxy]:
    """Runs `command` until the block ends; it must listen at the proxy's port."""

    def listens_or_has_ended() -> bool:
        with contextlib.suppress(OSError):
            socket.create_connection(("127.0.0.1", proxy.port)).close()
            return True
        return process.poll() is not None

    with open(log, "w") as out:
        process = subprocess.Popen(
            command, stdout=out, stderr=subprocess.STDOUT, env={**os.environ, **more}
        )
    try:
        wait_until(listens_or_has_ended)
        assert process.poll() is None, log.read_text()
        yield proxy
    finally:
        process.terminate()
        process.wait(timeout=BOUND_S)


@contextlib.contextmanager
def nginx(
    backend: int, folder: Path, root: Path = Path("/nowhere"), tls: bool = True
) -> Iterator[Proxy]:
    """Runs nginx with TLS in front of the server at port `backend`. root: folder of the streams
    that it sends from disk itself, with the secrets in `folder`/swings-secrets.map. tls: False for
    clients behind an emulated link."""
    port, plain_port = kept_port(), kept_port()
    certificate, key = make_certificate(folder / "tls")
    user = {r"^user www-data;": "user root;" if os.getuid() == 0 else ""}
    text = replaced(
        (DEPLOY / "nginx.conf").read_text(),
        user
        | {
            r"^pid .*;": f"pid {folder}/nginx.pid; daemon off;",
            r"^worker_processes auto;": "worker_processes 1;",
            r"/var/log/nginx": str(folder),
            r"/var/cache/nginx": str(folder / "cache"),
            r"listen 80;": f"listen 127.0.0.1:{plain_port};",
            r"listen 443 ssl http2": f"listen 127.0.0.1:{port}{' ssl http2' if tls else ''}",
            r"/etc/nginx/swings-secrets": f"{folder}/swings-secrets",
            r"/srv/swings": str(root),
            r"/etc/letsencrypt/live/video.example.org/fullchain.pem": str(certificate),
            r"/etc/letsencrypt/live/video.example.org/privkey.pem": str(key),
            r"127\.0\.0\.1:8080": f"127.0.0.1:{backend}",
            # Folders in which an nginx without root may write.
            r"default_type .*;": "".join(
                f"{name}_temp_path {folder}/{name};"
                for name in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
            ),
        },
    )
    (folder / "cache").mkdir()
    config = folder / "nginx.conf"
    config.write_text(text)
    program = find_program("nginx")
    assert program is not None
    command = [program, "-c", str(config), "-e", str(folder / "start.log")]
    subprocess.run([*command, "-t"], check=True, capture_output=True)
    with started(command, Proxy(port, tls), folder / "out.log") as proxy:
        yield proxy


@contextlib.contextmanager
def caddy(backend: int, folder: Path, open_root: Path | None = None) -> Iterator[Proxy]:
    """Runs Caddy in front of the server at port `backend`, without TLS, because there is no trusted
    certificate. open_root: folder of the streams whose objects it sends from disk itself."""
    port = kept_port()
    text = replaced(
        (DEPLOY / "Caddyfile").read_text(),
        {
            r"^\{$": "{\n\tadmin off",
            # `h` is the host of the requests that no honest client sends.
            r"^video\.example\.org \{": f"http://127.0.0.1:{port}, http://h:{port} {{\n\tlog",
            r"127\.0\.0\.1:8080": f"127.0.0.1:{backend}",
        },
    )
    config = folder / "Caddyfile"
    config.write_text(text)
    program = find_program("caddy")
    assert program is not None
    home = {name: str(folder) for name in ("HOME", "XDG_DATA_HOME", "XDG_CONFIG_HOME")}
    if open_root is not None:
        home["SWINGS_OPEN_ROOT"] = str(open_root)
    command = [program, "run", "--config", str(config), "--adapter", "caddyfile"]
    with started(command, Proxy(port, tls=False), folder / "out.log", **home) as proxy:
        yield proxy
