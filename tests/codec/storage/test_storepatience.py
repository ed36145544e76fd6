"""An object store that fails for a while, against a real HTTP server. Failures end after a number
of requests, so that no test measures time."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterator

import pytest

from codec.errors import ConflictError, SwingsError, UnwritableError
from codec.storage import objectstore
from codec.storage.objectstore import BRIEF, PATIENT, RetryPolicy, StorePrefix, open_store
from tests.support.hostile import refused
from tests.support.stores.failing_store import FailingStore, Failure, failing_store, tag
from tests.support.waiting import BOUND_S, wait_until

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
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[FailingStore]:
    with failing_store(monkeypatch) as server:
        server.objects["/b/x/there"] = b"0"
        yield server


def patient(monkeypatch: pytest.MonkeyPatch, policy: RetryPolicy) -> StorePrefix:
    monkeypatch.setattr(objectstore, "PATIENT", policy)
    return open_store("s3://b/x", patient=True)


@pytest.mark.parametrize("failure", ["500", "reset"])
@asks
def test_a_request_is_repeated_until_the_store_is_back(
    server: FailingStore, ask: str, failure: Failure, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = patient(monkeypatch, LONG)
    server.fail(failure, count=15)
    ASK[ask](store)
    assert server.requests == 16


@pytest.mark.parametrize(
    ("failure", "reason"),
    [("500", "HTTP 500 Internal Server Error"), ("reset", "Connection reset by peer")],
)
@asks
def test_a_store_that_stays_away_is_one_line(
    server: FailingStore, ask: str, failure: Failure, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = patient(monkeypatch, SHORT)
    server.fail(failure)
    error = refused(SwingsError, reason, lambda: ASK[ask](store))
    line = str(error)
    assert line.startswith("s3://b/x/")
    assert "\n" not in line
    assert "http://" not in line
    if failure == "500":
        assert re.search(r": \d+ attempts in \d+ s failed: HTTP 500|: HTTP 500", line)


def test_a_silent_store_is_one_line(server: FailingStore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AWS_TIMEOUT", "100ms")
    store = patient(monkeypatch, SHORT)
    server.fail("silent")
    for over in ("any", None):
        refused(UnwritableError, r"no response in time$", store.put, "new", b"1", over)


def test_a_put_without_a_response(server: FailingStore, monkeypatch: pytest.MonkeyPatch) -> None:
    """The callers check whether the object is their own."""
    store = patient(monkeypatch, LONG)
    server.fail("reset_after", count=1)
    refused(ConflictError, "", store.put, "new", b"1", None)
    assert server.objects["/b/x/new"] == b"1"


def test_what_the_store_forbids_is_asked_once(server: FailingStore) -> None:
    store = open_store("s3://b/x", patient=True)
    server.fail("403")
    for ask in (lambda: store.read("there", 10), lambda: store.put("new", b"1")):
        server.requests = 0
        refused(SwingsError, r"HTTP 403|Forbidden", ask)
        assert server.requests == 1


def test_missing_credentials(server: FailingStore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(objectstore, "BRIEF", RetryPolicy(BOUND_S, 0.001, 0.001, max_retries=2))
    monkeypatch.delenv("AWS_ACCESS_KEY_ID")
    monkeypatch.delenv("AWS_SECRET_ACCESS_KEY")
    monkeypatch.setenv("AWS_METADATA_ENDPOINT", "http://127.0.0.1:1")  # nothing listens there
    with pytest.raises(SwingsError, match=r"^s3://b/x.*: no credentials: set AWS_ACCESS_KEY_ID"):
        open_store("s3://b/x", patient=True).put("new", b"1")
    monkeypatch.setenv("AWS_SKIP_SIGNATURE", "true")
    assert open_store("s3://b/x", patient=True).read("there", 10) == b"0"


def test_a_server_does_not_wait_for_its_store(server: FailingStore) -> None:
    store = open_store("s3://b/x")
    server.fail("500")
    refused(SwingsError, "3 attempts in", store.read, "there", 10)
    assert server.requests == 1 + BRIEF.max_retries


def test_a_store_may_fail_go_away_and_come_back(monkeypatch: pytest.MonkeyPatch) -> None:
    assert (PATIENT.duration_s, PATIENT.max_retries) == (60.0, 10_000)
    with failing_store(monkeypatch) as server:
        store = patient(monkeypatch, LONG)
        server.fail("500")
        answers: list[object] = []
        thread = threading.Thread(target=lambda: answers.append(store.put("new", b"1", None)))
        thread.start()
        wait_until(lambda: server.requests > 5)
    assert thread.is_alive()
    with failing_store(monkeypatch, server.server_port):
        thread.join(timeout=BOUND_S)
    assert len(answers) == 1
