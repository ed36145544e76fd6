"""Object stores: a real S3 server, one that fails for a while, and a line for each failure."""

from __future__ import annotations

import json
import os
import re
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

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
from codec.storage.objectstore import BRIEF, PATIENT, RetryPolicy, StorePrefix, open_store
from codec.storage.openstorage import open_storage
from tests.support.commands import run, run_ok
from tests.support.hostile import refused
from tests.support.stores.failing_store import FailingStore, Failure, failing_store, tag
from tests.support.stores.s3_server import BUCKET, S3Server, s3_server
from tests.support.tiny_stream import write_tiny
from tests.support.waiting import BOUND_S, wait_until

pytest.importorskip("obstore", reason="object stores need the extra s3")


@pytest.fixture(scope="module")
def server() -> Iterator[S3Server]:
    with s3_server() as server:
        yield server


def test_the_commands_take_urls(server: S3Server, tmp_path: Path) -> None:
    write_tiny(tmp_path / "s", 4)
    server.upload(tmp_path / "s", "deep/er/s")
    url = f"s3://{BUCKET}/deep/er/s"
    told = json.loads(run_ok("swings-stream", "info", f"{url}/", "--json"))
    assert told == json.loads(run_ok("swings-stream", "info", tmp_path / "s", "--json"))
    done = run("swings-stream", "verify", f"s3://{BUCKET}/nothing")
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert f"s3://{BUCKET}/nothing/manifest.json is missing" in done.stderr


def test_what_a_store_refuses_is_a_line(server: S3Server, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(objectstore, "BRIEF", RetryPolicy(10.0, 0.001, 0.001, max_retries=1))
    storage = open_storage("s3://no-such-bucket/x")
    error = refused(UnreadableError, "", storage.check)
    assert str(error).startswith("s3://no-such-bucket/x/ cannot be read: ")
    assert "NoSuchBucket" in str(error)
    held = open_storage(f"s3://{BUCKET}/x")
    server.stop()
    try:
        for ask in (held.check, lambda: held.read("m", 10), lambda: held.stamp("m")):
            error = refused(UnreadableError, "", ask)
            assert "\n" not in str(error)
            assert len(str(error)) < 400
    finally:
        server.start()
    assert held.stamp("m") is None


@pytest.mark.parametrize(
    ("changes", "advice"),
    [
        ({"AWS_ALLOW_HTTP": "false"}, "which AWS_ALLOW_HTTP forbids; set it to true"),
        (dict.fromkeys(("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY")), "or AWS_SKIP_SIGNATURE"),
    ],
)
def test_the_variable_to_set_is_named(
    server: S3Server, changes: dict[str, str | None], advice: str, monkeypatch: pytest.MonkeyPatch
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
def test_an_endpoint_is_a_url(server: S3Server, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    endpoint = os.environ["AWS_ENDPOINT_URL"]
    monkeypatch.delenv("AWS_ENDPOINT_URL")
    monkeypatch.setenv(name, endpoint)
    monkeypatch.delenv("AWS_ALLOW_HTTP", raising=False)
    server.put("x/m", b"data")
    assert open_storage(f"s3://{BUCKET}/x").read("m", 10) == b"data"
    for wrong in ("localhost:9000", "127.0.0.1", "", "minio"):
        monkeypatch.setenv(name, wrong)
        refused(InvalidError, rf"^{name} is '{wrong}'; set it to a URL", open_storage, "s3://b/x")


def test_a_path_that_no_store_takes_is_an_error_of_ours(server: S3Server) -> None:
    for path in ("../x", "a//b", "", "a/./b"):
        with pytest.raises(CodecError):
            open_storage(f"s3://{BUCKET}/x").read(path, 10)


def test_a_read_is_bounded(server: S3Server) -> None:
    server.put("x/big", bytes(3 << 20))
    storage = open_storage(f"s3://{BUCKET}/x")
    assert len(storage.read("big", 3 << 20)) == 3 << 20
    refused(CodecError, f"s3://{BUCKET}/x/big is longer than 1000 bytes", storage.read, "big", 1000)
    refused(CodecError, "is longer than 1000 bytes", storage.read, "big", 1000, (3 << 20) - 1001)
    assert storage.read("big", 1000, (3 << 20) - 1000) == bytes(1000)


@pytest.mark.parametrize("url", ["s3://", "S3:///x", "s3://[", "file:///etc", "ftp://x/y", "x://"])
def test_a_url_that_names_no_store_is_refused(url: str) -> None:
    refused(InvalidError, r"does not name an object store|choose a folder", open_storage, url)


def test_without_obstore_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "obstore", None)
    monkeypatch.setitem(sys.modules, "obstore.exceptions", None)
    expected = r"^s3://b/x: .* pip install '\.\[s3\]' in the folder of swings$"
    refused(InvalidError, expected, open_storage, "s3://name:password@b/x")


pytest.importorskip("obstore", reason="object stores need the extra s3")

LONG = RetryPolicy(BOUND_S, 0.001, 0.005, max_retries=10_000)
SHORT = RetryPolicy(0.05, 0.001, 0.005, max_retries=10_000)

ASK: dict[str, Callable[[StorePrefix], object]] = {
    "read": lambda store: store.read("there", 10),
    "stamp": lambda store: store.stamp("there"),
    "put": lambda store: store.put("new", b"1"),
    "put_first": lambda store: store.put("new", b"1", None),
    "put_over": lambda store: store.put("there", b"1", {"e_tag": tag(b"0")}),
}
asks = pytest.mark.parametrize("ask", ASK)


@pytest.fixture
def failing(monkeypatch: pytest.MonkeyPatch) -> Iterator[FailingStore]:
    with failing_store(monkeypatch) as failing:
        failing.objects["/b/x/there"] = b"0"
        yield failing


def patient(monkeypatch: pytest.MonkeyPatch, policy: RetryPolicy) -> StorePrefix:
    monkeypatch.setattr(objectstore, "PATIENT", policy)
    return open_store("s3://b/x", patient=True)


@pytest.mark.parametrize("failure", ["500", "reset"])
@asks
def test_a_request_is_repeated_until_the_store_is_back(
    failing: FailingStore, ask: str, failure: Failure, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = patient(monkeypatch, LONG)
    failing.fail(failure, count=15)
    ASK[ask](store)
    assert failing.requests == 16


@pytest.mark.parametrize(
    ("failure", "reason"),
    [("500", "HTTP 500 Internal Server Error"), ("reset", "Connection reset by peer")],
)
@asks
def test_a_store_that_stays_away_is_one_line(
    failing: FailingStore, ask: str, failure: Failure, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = patient(monkeypatch, SHORT)
    failing.fail(failure)
    error = refused(SwingsError, reason, lambda: ASK[ask](store))
    line = str(error)
    assert line.startswith("s3://b/x/")
    assert "\n" not in line
    assert "http://" not in line
    if failure == "500":
        assert re.search(r": \d+ attempts in \d+ s failed: HTTP 500|: HTTP 500", line)


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


def test_a_store_may_fail_go_away_and_come_back(monkeypatch: pytest.MonkeyPatch) -> None:
    assert (PATIENT.duration_s, PATIENT.max_retries) == (60.0, 10_000)
    with failing_store(monkeypatch) as failing:
        store = patient(monkeypatch, LONG)
        failing.fail("500")
        answers: list[object] = []
        thread = threading.Thread(target=lambda: answers.append(store.put("new", b"1", None)))
        thread.start()
        wait_until(lambda: failing.requests > 5)
    assert thread.is_alive()
    with failing_store(monkeypatch, failing.server_port):
        thread.join(timeout=BOUND_S)
    assert len(answers) == 1
