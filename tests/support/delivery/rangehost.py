"""A static host with ranges and kept connections, which counts, and fails on request."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from mimetypes import guess_type
from pathlib import Path

from tests.support.hosted_streams import answering


class RangeHost:
    """Serves the files of `root`."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.asked: list[tuple[str, str]] = []
        """(path, range) of each request."""
        self.cut_bytes: int | None = None
        """Number of bytes after which each body breaks off."""
        self.knows_ranges = True
        self.cors = False
        """Whether pages of other origins may read the files."""
        self.gone = False
        """Whether the host closes the connection at every request."""
        self.refusals: list[tuple[int, dict[str, str]]] = []
        """Statuses and fields of the next responses."""
        self.url = ""

    def answer(self, handler: BaseHTTPRequestHandler) -> None:
        path = handler.path.partition("?")[0]
        self.asked.append((path, handler.headers.get("Range", "")))
        if self.gone:
            handler.close_connection = True
            return
        if self.refusals:
            status, fields = self.refusals.pop(0)
            self._send(handler, status, fields, b"")
            return
        try:
            data = (self.root / path.lstrip("/")).read_bytes()
        except OSError:
            self._send(handler, 404, {}, b"")
            return
        tag = f'"{hashlib.sha256(data).hexdigest()}"'
        fields = {"ETag": tag, "Content-Type": guess_type(path)[0] or "application/octet-stream"}
        found = re.fullmatch(r"bytes=(\d+)-(\d*)", handler.headers.get("Range", ""))
        if found and self.knows_ranges and handler.headers.get("If-Range", tag) == tag:
            first, last = int(found[1]), min(int(found[2] or len(data) - 1), len(data) - 1)
            if first >= len(data):
                self._send(handler, 416, fields, b"")
                return
            fields["Content-Range"] = f"bytes {first}-{last}/{len(data)}"
            self._send(handler, 206, fields, data[first : last + 1])
        else:
            self._send(handler, 200, fields, data)

    def _send(
        self, handler: BaseHTTPRequestHandler, status: int, fields: dict[str, str], body: bytes
    ) -> None:
        handler.send_response(status)
        for name, value in fields.items():
            handler.send_header(name, value)
        if self.cors:
            handler.send_header("Access-Control-Allow-Origin", "*")
        handler.send_header("Content-Length", str(len(body)))
        handler.end_headers()
        if self.cut_bytes is not None and len(body) > self.cut_bytes:
            body = body[: self.cut_bytes]
            handler.close_connection = True
        handler.wfile.write(body)

    def objects(self) -> list[str]:
        """Paths of the requested objects, in order."""
        return [path for path, _ in self.asked if "/segments/" in path]


@contextmanager
def range_host(root: Path) -> Iterator[RangeHost]:
    host = RangeHost(root)

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"
        disable_nagle_algorithm = True

        def do_GET(self) -> None:
            host.answer(self)

        def log_message(self, format: str, *args: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    host.url = f"http://127.0.0.1:{server.server_port}"
    with answering(server):
        yield host
