"""An object store that fails for a while, against a real HTTP server."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterator

import pytest

from codec.errors import ConflictError, SwingsError, UnwritableError
from codec.storage import objectstore
from codec.storage.objectstore import BRIEF, PATIENT, RetryPolicy, StorePrefix, open_store
from tests.support.stores.failing_store import FailingStore, Failure, failing_store, tag

pytest.importorskip("obstore", reason="object stores need the extra s3")

SHORT = RetryPolicy(1.5, 0.05, 0.2, max_retries=10_000)
"""The policy PATIENT with shorter times."""

ASK: dict[str, Callable[[StorePrefix], object]] = {
    "read": lambda store: store.read("there", 10),
    "stamp": lambda store: store.stamp("there"),
    "put": lambda store: store.put("new", b"1"),
    "put_first": lambda store: store.put("new", b"1", None),
    "put_over": lambda store: store.put("there", b"1", {"e_tag": tag(b"0")}),
}


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[FailingStore]:
    with failing_store(monkeypatch) as server:
        server.objects["/b/x/there"] = b"0"
        yield server


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(objectstore, "PATIENT", SHORT)


@pytest.mark.parametrize("failure", ["500", "reset"])
@pytest.mark.parametrize("ask", ASK)
@pytest.mark.usefixtures("short")
def test_a_request_is_repeated_until_the_store_is_back(
    server: FailingStore, ask: str, failure: Failure
) -> None:
    store = open_store("s3://b/x", patient=True)
    server.fail(failure, duration_s=0.6)
    begin_s = time.monotonic()
    ASK[ask](store)
    assert time.monotonic() - begin_s >= 0.6
    assert server.requests > 2


@pytest.mark.parametrize(
    ("failure", "reason"),
    [("500", "HTTP 500 Internal Server Error"), ("reset", "Connection reset by peer")],
)
@pytest.mark.parametrize("ask", ASK)
@pytest.mark.usefixtures("short")
def test_a_store_that_stays_away_is_one_line_after_that_time(
    server: FailingStore, ask: str, failure: Failure, reason: str
) -> None:
    store = open_store("s3://b/x", patient=True)
    server.fail(failure, duration_s=60.0)
    begin_s = time.monotonic()
    with pytest.raises(SwingsError, match=reason) as caught:
        ASK[ask](store)
    assert SHORT.duration_s <= time.monotonic() - begin_s < SHORT.duration_s + 3.0
    line = str(caught.value)
    assert line.startswith("s3://b/x/")
    assert "\n" not in line
    assert "http://" not in line
    if failure == "500":
        assert re.search(r": \d+ attempts in \d s failed: HTTP 500", line)


@pytest.mark.usefixtures("short")
def test_a_store_that_is_silent_is_one_line(
    server: FailingStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AWS_TIMEOUT", "1s")
    store = open_store("s3://b/x", patient=True)
    server.fail("silent", duration_s=60.0)
    for over in ("any", None):
        with pytest.raises(UnwritableError, match=r"no response in time$"):
            store.put("new", b"1", over)


@pytest.mark.usefixtures("short")
def test_a_put_whose_response_was_lost_is_a_conflict_with_itself(server: FailingStore) -> None:
    """The callers check whether the object is their own."""
    store = open_store("s3://b/x", patient=True)
    server.fail("reset_after", count=1)
    with pytest.raises(ConflictError):
        store.put("new", b"1", None)
    assert server.objects["/b/x/new"] == b"1"


def test_what_the_store_forbids_is_asked_once(server: FailingStore) -> None:
    store = open_store("s3://b/x", patient=True)
    server.fail("403", duration_s=60.0)
    for ask in (lambda: store.read("there", 10), lambda: store.put("new", b"1")):
        server.requests = 0
        with pytest.raises(SwingsError, match=r"HTTP 403|Forbidden"):
            ask()
        assert server.requests == 1


def test_missing_credentials_are_reported_at_once(
    server: FailingStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("AWS_ACCESS_KEY_ID")
    monkeypatch.delenv("AWS_SECRET_ACCESS_KEY")
    monkeypatch.setenv("AWS_METADATA_ENDPOINT", "http://127.0.0.1:1")  # nothing listens there
    begin_s = time.monotonic()
    with pytest.raises(SwingsError, match=r"^s3://b/x.*: no credentials: set AWS_ACCESS_KEY_ID"):
        open_store("s3://b/x", patient=True).put("new", b"1")
    assert time.monotonic() - begin_s < 5.0
    monkeypatch.setenv("AWS_SKIP_SIGNATURE", "true")
    assert open_store("s3://b/x", patient=True).read("there", 10) == b"0"


def test_a_server_does_not_wait_for_its_store(server: FailingStore) -> None:
    store = open_store("s3://b/x")
    server.fail("500", duration_s=60.0)
    begin_s = time.monotonic()
    with pytest.raises(SwingsError, match="3 attempts in"):
        store.read("there", 10)
    assert server.requests == 1 + BRIEF.max_retries
    assert time.monotonic() - begin_s < 5.0


@pytest.mark.slow
def test_ten_seconds_without_a_store_are_survived(monkeypatch: pytest.MonkeyPatch) -> None:
    """5 s of errors, then 5 s without a server, with the real times."""
    assert PATIENT.duration_s == 60.0
    with failing_store(monkeypatch) as server:
        store = open_store("s3://b/x", patient=True)
        server.fail("500", duration_s=60.0)
        answers: list[object] = []
        thread = threading.Thread(target=lambda: answers.append(store.put("new", b"1", None)))
        thread.start()
        time.sleep(5.0)
        assert thread.is_alive()
    time.sleep(5.0)
    assert thread.is_alive()
    with failing_store(monkeypatch, server.server_port):
        thread.join(timeout=30.0)
    assert len(answers) == 1
