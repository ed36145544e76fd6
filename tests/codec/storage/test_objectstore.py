"""Object stores: a real S3 server, one that fails for a while, and a line for each failure."""

from __future__ import annotations

import hashlib
import json
import math
import os
import socket
import struct
import sys
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, Literal

import pytest

from codec.errors import (
    CodecError,
    ConflictError,
    InvalidError,
    SwingsError,
    UnreadableError,
    UnwritableError,
)
from codec.storage import objectstore
from codec.storage.objectstore import BRIEF, RetryPolicy, StorePrefix, open_store
from codec.storage.openstorage import open_storage
from tests.support.commands import run, run_ok
from tests.support.hosted_streams import answering
from tests.support.hostile import refused
from tests.support.stores.s3_server import BUCKET, S3Server
from tests.support.tiny_stream import write_tiny
from tests.support.waiting import BOUND_S

pytest.importorskip("obstore", reason="object stores need the extra s3")


def test_the_commands_take_urls(s3: S3Server, tmp_path: Path) -> None:
    write_tiny(tmp_path / "s", 4)
    s3.upload(tmp_path / "s", "deep/er/s")
    url = f"s3://{BUCKET}/deep/er/s"
    told = json.loads(run_ok("swings-stream", "info", f"{url}/", "--json"))
    assert told == json.loads(run_ok("swings-stream", "info", tmp_path / "s", "--json"))
    done = run("swings-stream", "verify", f"s3://{BUCKET}/nothing")
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert f"s3://{BUCKET}/nothing/manifest.json is missing" in done.stderr


def test_what_a_store_refuses_is_a_line(s3: S3Server, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(objectstore, "BRIEF", RetryPolicy(10.0, 0.001, 0.001, max_retries=1))
    storage = open_storage("s3://no-such-bucket/x")
    error = refused(UnreadableError, "", storage.check)
    assert str(error).startswith("s3://no-such-bucket/x/ cannot be read: ")
    assert "NoSuchBucket" in str(error)
    held = open_storage(f"s3://{BUCKET}/x")
    s3.stop()
    try:
        for ask in (held.check, lambda: held.read("m", 10), lambda: held.stamp("m")):
            error = refused(UnreadableError, "", ask)
            assert "\n" not in str(error)
            assert len(str(error)) < 400
    finally:
        s3.start()
    assert held.stamp("m") is None


@pytest.mark.parametrize(
    ("changes", "advice"),
    [
        ({"AWS_ALLOW_HTTP": "false"}, "which AWS_ALLOW_HTTP forbids; set it to true"),
        (dict.fromkeys(("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY")), "or AWS_SKIP_SIGNATURE"),
    ],
)
def test_the_variable_to_set_is_named(
    s3: S3Server, changes: dict[str, str | None], advice: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in changes.items():
        if value is None:
            monkeypatch.delenv(name)
        else:
            monkeypatch.setenv(name, value)
    storage = open_storage(f"s3://{BUCKET}/x")
    for ask in (storage.check, lambda: storage.read("m", 10)):
        error = refused(UnreadableError, advice, ask)
        assert "169.254" not in str(error)
        assert "builder" not in str(error)


@pytest.mark.parametrize("name", ["AWS_ENDPOINT_URL", "AWS_ENDPOINT", "AWS_ENDPOINT_URL_S3"])
def test_an_endpoint_is_a_url(s3: S3Server, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    endpoint = os.environ["AWS_ENDPOINT_URL"]
    monkeypatch.delenv("AWS_ENDPOINT_URL")
    monkeypatch.setenv(name, endpoint)
    monkeypatch.delenv("AWS_ALLOW_HTTP", raising=False)
    s3.put("named/m", b"data")
    assert open_storage(f"s3://{BUCKET}/named").read("m", 10) == b"data"
    for wrong in ("localhost:9000", "127.0.0.1", "", "minio"):
        monkeypatch.setenv(name, wrong)
        refused(InvalidError, rf"^{name} is '{wrong}'; set it to a URL", open_storage, "s3://b/x")


def test_a_path_that_no_store_takes_is_an_error_of_ours(s3: S3Server) -> None:
    for path in ("../x", "a//b", "", "a/./b"):
        with pytest.raises(CodecError):
            open_storage(f"s3://{BUCKET}/x").read(path, 10)


@pytest.mark.parametrize("url", ["s3://", "S3:///x", "s3://[", "file:///etc", "ftp://x/y", "x://"])
def test_a_url_that_names_no_store_is_refused(url: str) -> None:
    refused(InvalidError, r"does not name an object store|choose a folder", open_storage, url)


def test_without_obstore_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "obstore", None)
    monkeypatch.setitem(sys.modules, "obstore.exceptions", None)
    expected = r"^s3://b/x: .* pip install '\.\[s3\]' in the folder of swings$"
    refused(InvalidError, expected, open_storage, "s3://name:password@b/x")


Failure = Literal["500", "403", "reset", "reset_after", "silent"]
"""A status; or a connection reset before or after the request is executed; or no response."""


class FailingStore(ThreadingHTTPServer):
    """Answers GET, HEAD and PUT of whole objects, with If-Match and If-None-Match."""

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.objects = {"/b/x/there": b"0"}
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
        self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
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


LONG = RetryPolicy(BOUND_S, 0.001, 0.005, max_retries=10_000)
SHORT = RetryPolicy(0.05, 0.001, 0.005, max_retries=10_000)

ASK: dict[str, Callable[[StorePrefix], object]] = {
    "read": lambda store: store.read("there", 10),
    "stamp": lambda store: store.stamp("there"),
    "put": lambda store: store.put("new", b"1"),
    "put_first": lambda store: store.put("new", b"1", None),
    "put_over": lambda store: store.put("there", b"1", {"e_tag": tag(b"0")}),
}


@pytest.fixture
def failing(monkeypatch: pytest.MonkeyPatch) -> Iterator[FailingStore]:
    server = FailingStore()
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


def patient(monkeypatch: pytest.MonkeyPatch, policy: RetryPolicy) -> StorePrefix:
    monkeypatch.setattr(objectstore, "PATIENT", policy)
    return open_store("s3://b/x", patient=True)


@pytest.mark.parametrize(
    ("failure", "reason"),
    [
        ("500", r"(: \d+ attempts in \d+ s failed)?: HTTP 500 Internal Server Error"),
        ("reset", "Connection reset by peer"),
    ],
)
@pytest.mark.parametrize("ask", ASK)
def test_a_request_is_repeated_until_the_store_is_back_or_time_is_up(
    failing: FailingStore, ask: str, failure: Failure, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = patient(monkeypatch, SHORT)
    failing.fail(failure)
    line = str(refused(SwingsError, rf"^s3://b/x/.*{reason}", lambda: ASK[ask](store)))
    assert "\n" not in line
    assert "http://" not in line
    store, failing.requests = patient(monkeypatch, LONG), 0
    failing.fail(failure, count=15)
    ASK[ask](store)
    assert failing.requests == 16


def test_a_silent_store_is_one_line(failing: FailingStore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AWS_TIMEOUT", "100ms")
    store = patient(monkeypatch, SHORT)
    failing.fail("silent")
    for over in ("any", None):
        refused(UnwritableError, r"no response in time$", store.put, "new", b"1", over)


def test_a_put_without_a_response(failing: FailingStore, monkeypatch: pytest.MonkeyPatch) -> None:
    """The callers check whether the object is their own."""
    store = patient(monkeypatch, LONG)
    failing.fail("reset_after", count=1)
    refused(ConflictError, "", store.put, "new", b"1", None)
    assert failing.objects["/b/x/new"] == b"1"


def test_what_the_store_forbids_is_asked_once(failing: FailingStore) -> None:
    store = open_store("s3://b/x", patient=True)
    failing.fail("403")
    for ask in (lambda: store.read("there", 10), lambda: store.put("new", b"1")):
        failing.requests = 0
        refused(SwingsError, r"HTTP 403|Forbidden", ask)
        assert failing.requests == 1


def test_missing_credentials(failing: FailingStore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(objectstore, "BRIEF", RetryPolicy(BOUND_S, 0.001, 0.001, max_retries=2))
    monkeypatch.delenv("AWS_ACCESS_KEY_ID")
    monkeypatch.delenv("AWS_SECRET_ACCESS_KEY")
    monkeypatch.setenv("AWS_METADATA_ENDPOINT", "http://127.0.0.1:1")  # nothing listens there
    with pytest.raises(SwingsError, match=r"^s3://b/x.*: no credentials: set AWS_ACCESS_KEY_ID"):
        open_store("s3://b/x", patient=True).put("new", b"1")
    monkeypatch.setenv("AWS_SKIP_SIGNATURE", "true")
    assert open_store("s3://b/x", patient=True).read("there", 10) == b"0"


def test_a_server_does_not_wait_for_its_store(failing: FailingStore) -> None:
    store = open_store("s3://b/x")
    failing.fail("500")
    refused(SwingsError, "3 attempts in", store.read, "there", 10)
    assert failing.requests == 1 + BRIEF.max_retries
