"""A small S3 server in memory that fails on request."""

from __future__ import annotations

import hashlib
import math
import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Literal

import pytest

from tests.support.hosted_streams import answering

Failure = Literal["500", "403", "reset", "reset_after", "silent"]
"""A status; or a connection reset before or after the request is executed; or no response."""

RESET = struct.pack("ii", 1, 0)


class FailingStore(ThreadingHTTPServer):
    """Answers GET, HEAD and PUT of whole objects, with If-Match and If-None-Match."""

    daemon_threads = True

    def __init__(self, port: int = 0) -> None:
        super().__init__(("127.0.0.1", port), Handler)
        self.objects: dict[str, bytes] = {}
        self.requests = 0
        self._failure: Failure | None = None
        self._count = 0.0
        self.ended = threading.Event()

    def shutdown_request(self, request: Any) -> None:
        self.close_request(request)  # without a FIN, which would be sent before a reset

    def fail(self, failure: Failure, *, count: float = math.inf) -> None:
        """Makes the next `count` requests fail."""
        self._failure, self._count = failure, count

    def next_failure(self) -> Failure | None:
        self.requests += 1
        self._count -= 1
        return self._failure if self._count >= 0 else None


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: FailingStore

    def do_PUT(self) -> None:
        data = self.rfile.read(int(self.headers["Content-Length"]))
        failure = self.server.next_failure()
        if failure is not None and failure != "reset_after":
            self._fail(failure)
            return
        found = self.server.objects.get(self.path)
        wanted = self.headers["If-Match"]
        if (self.headers["If-None-Match"] == "*" and found is not None) or (
            wanted is not None and (found is None or wanted != tag(found))
        ):
            self._answer(412)
            return
        self.server.objects[self.path] = data
        if failure is None:
            self._answer(200, data, body=b"")
        else:
            self._fail("reset")

    def do_GET(self) -> None:
        failure = self.server.next_failure()
        if failure is not None:
            self._fail(failure)
            return
        found = self.server.objects.get(self.path)
        self._answer(404) if found is None else self._answer(200, found, body=found)

    do_HEAD = do_GET

    def _fail(self, failure: Failure) -> None:
        if failure.isdigit():
            self._answer(int(failure))
            return
        if failure == "silent":
            self.server.ended.wait()
        self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
        self.close_connection = True

    def _answer(self, status: int, content: bytes | None = None, body: bytes = b"") -> None:
        self.send_response(status)
        if content is not None:
            self.send_header("ETag", tag(content))
            self.send_header("Last-Modified", self.date_time_string(0))
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:
        pass


def tag(content: bytes) -> str:
    return f'"{hashlib.md5(content).hexdigest()}"'


@contextmanager
def failing_store(monkeypatch: pytest.MonkeyPatch, port: int = 0) -> Iterator[FailingStore]:
    """Runs a server; the environment points to it for the rest of the test."""
    server = FailingStore(port)
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "id")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "key")
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{server.server_port}")
    monkeypatch.setenv("AWS_ALLOW_HTTP", "true")
    with answering(server):
        try:
            yield server
        finally:
            server.fail("reset")  # on connections that are still open
            server.ended.set()
