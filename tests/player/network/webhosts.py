"""Hosts on this machine: one with scripted responses, and one with files, which may need a
password, use TLS or act as a proxy."""

from __future__ import annotations

import re
import select
import socket
import ssl
import threading
from base64 import b64encode
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from functools import partial
from http.client import HTTPConnection
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import urlsplit

from tests.support.hosted_streams import answering

LOGIN = "ursula:top%3As%40cret"
LOGIN_HEADER = f"Basic {b64encode(b'ursula:top:s@cret').decode()}"
SECRETS = ("ursula", "cret")

PROXY_LOGIN = "paula:geheim"
PROXY_LOGIN_HEADER = f"Basic {b64encode(PROXY_LOGIN.encode()).decode()}"


HOLD = b"<hold>"
"""After an answer, and not sent: the connection stays open, for no other answer."""

NO_ANSWER = b"HTTP/1.1 200 OK\r\n" + HOLD
"""The beginning of a head, and no more."""


class ScriptedHost:
    """Gives each request the next of `answers`, whatever is asked; closes the connection after an
    answer that says so, or that is empty, and after the last one."""

    def __init__(self, *answers: bytes) -> None:
        self._answers = list(answers)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        self.requests: list[bytes] = []
        self.num_connections = 0
        self._held: list[socket.socket] = []
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def asked(self) -> list[str]:
        """The target of each request."""
        return [request.split()[1].decode() for request in self.requests]

    def _run(self) -> None:
        while self._answers:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            self.num_connections += 1
            with connection, suppress(ConnectionError):
                while self._answers and self._has_request(connection):
                    answer = self._answers.pop(0)
                    connection.sendall(answer.removesuffix(HOLD))
                    if answer.endswith(HOLD):
                        self._held.append(connection.dup())
                        break
                    if not answer or b"close" in answer[:200] or answer.startswith(b"HTTP/1.0"):
                        break

    def _has_request(self, connection: socket.socket) -> bool:
        request = b""
        while not is_whole(request) and request[:1] != b"\x16":  # or a handshake of TLS
            piece = connection.recv(65536)
            if not piece:
                return False
            request += piece
        self.requests.append(request)
        return True

    def close(self) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join(5)
        for connection in self._held:
            connection.close()


def is_whole(request: bytes) -> bool:
    head, end, body = request.partition(b"\r\n\r\n")
    length = re.search(rb"Content-Length: (\d+)", head)
    return bool(end) and len(body) >= (int(length[1]) if length else 0)


def script(*answers: bytes) -> closing[ScriptedHost]:
    return closing(ScriptedHost(*answers))


class WebHost(ThreadingHTTPServer):
    """Serves the files of a folder, and forwards requests as a proxy."""

    def __init__(self, folder: Path, login: str | None) -> None:
        super().__init__(("127.0.0.1", 0), partial(WebHandler, directory=str(folder)))
        self.login = login
        """Authorization that files require; None for none."""
        self.moved_to = ""
        """Target of redirects, which replace files; empty for none."""
        self.refusal = 0
        """Status of every response; 0 for no refusal."""
        self.requests: list[tuple[str, str]] = []
        """The method and target of each request."""
        self.logins: list[str | None] = []
        """The Authorization of each request."""
        self.proxy_logins: set[str | None] = set()
        self.tunnelled = b""
        """All bytes that clients sent through tunnels."""
        self.num_connections = self.num_open = 0

    def get_request(self) -> tuple[socket.socket, object]:
        self.num_connections += 1
        return super().get_request()

    def handle_error(self, request: object, client_address: object) -> None:
        """Ignores errors from clients that refuse the TLS handshake."""


class WebHandler(SimpleHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: WebHost

    def setup(self) -> None:
        super().setup()
        self.server.num_open += 1

    def finish(self) -> None:
        self.server.num_open -= 1
        super().finish()

    def parse_request(self) -> bool:
        if not super().parse_request():
            return False
        server = self.server
        server.requests.append((self.command, self.path))
        server.logins.append(self.headers.get("Authorization"))
        server.proxy_logins.add(self.headers.get("Proxy-Authorization"))
        if server.refusal:
            self.send_error(server.refusal)
        return not server.refusal

    def do_GET(self) -> None:
        if not self.path.startswith("/"):
            self._forward()
        elif self.server.moved_to:
            self._answer(302, {"Location": self.server.moved_to + self.path}, b"")
        elif self.server.login in (None, self.headers.get("Authorization")):
            super().do_GET()
        else:
            self.send_error(401)

    def _forward(self) -> None:
        parts = urlsplit(self.path)
        passed = {name: text for name, text in self.headers.items() if name[:6] != "Proxy-"}
        with closing(HTTPConnection(parts.hostname or "", parts.port)) as host:
            host.request("GET", parts.path, headers=passed)
            answer = host.getresponse()
            kind = answer.headers.get("Content-Type", "")
            self._answer(answer.status, {"Content-Type": kind}, answer.read())

    def _answer(self, status: int, headers: dict[str, str], body: bytes) -> None:
        self.send_response(status)
        for name, text in headers.items() | {("Content-Length", str(len(body)))}:
            self.send_header(name, text)
        self.end_headers()
        self.wfile.write(body)

    def do_CONNECT(self) -> None:
        host, _, port = self.path.rpartition(":")
        with closing(socket.create_connection((host.strip("[]"), int(port)))) as far:
            self.send_response(200)
            self.end_headers()
            with suppress(OSError):
                self._tunnel(far)
        self.close_connection = True

    def _tunnel(self, far: socket.socket) -> None:
        ends = {self.connection: far, far: self.connection}
        while True:
            for end in select.select(list(ends), [], [])[0]:
                data = end.recv(65536)
                if not data:
                    return
                ends[end].sendall(data)
                if end is self.connection:
                    self.server.tunnelled += data

    def log_message(self, format: str, *args: object) -> None:
        pass


@contextmanager
def web_host(
    folder: Path, certificate: tuple[Path, Path] | None = None, login: str | None = None
) -> Iterator[WebHost]:
    """Runs a WebHost. certificate: enables TLS, with its key."""
    server = WebHost(folder, login)
    if certificate is not None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(*certificate)
        server.socket = context.wrap_socket(
            server.socket, server_side=True, do_handshake_on_connect=False
        )
    with answering(server):
        yield server
