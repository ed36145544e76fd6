"""Hostile requests and variations of them, checked byte by byte; see fuzz/http.py."""

from __future__ import annotations

import random
from collections.abc import Iterator

import pytest

from fuzz.http import SECRET, Served, check_responses
from fuzz.httpseed import requests
from server.exchange.exchange import Exchange
from tests.support.hostile import refused

REQUESTS = requests()


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    served = Served(tmp_path_factory.mktemp("fuzz"))
    yield served
    served.close()


def test_each_is_answered_well(served: Served) -> None:
    found = {status for sent in REQUESTS for status in served.answers(sent)}
    assert {200, 204, 206, 304, 400, 404, 405, 411, 412, 416, 505} <= found


def test_what_is_near_them_is_answered_well(served: Served) -> None:
    """A short version of the fuzzer's work, with the same mutations in each run."""
    rng = random.Random(1)
    for sent in REQUESTS:
        if b"paused" in sent:
            continue  # each takes half a second
        for _ in range(5):
            altered = bytearray(sent)
            for _ in range(rng.randint(1, 4)):
                place = rng.randrange(len(altered) + 1)
                match rng.randrange(3):
                    case 0:
                        altered[place : place + 1] = rng.randbytes(1)
                    case 1:
                        del altered[place : place + rng.randint(1, 8)]
                    case _:
                        other = rng.choice(REQUESTS)
                        altered[place:place] = other[: rng.randint(1, 60)]
            served.answers(bytes(altered))


def test_the_law_can_be_broken(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    get = b"GET /healthz HTTP/1.1\r\nHost: h\r\n\r\n"
    monkeypatch.setattr("server.app.find_route", lambda *values: 1 / 0)
    refused(AssertionError, "Exchange", served.answers, get)
    monkeypatch.undo()
    assert served.answers(get) == [200]
    good = b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\nok"
    exchange = Exchange("", 0.0, status=200)
    assert check_responses(good, [exchange]) == [200]
    for bad in (good + SECRET, good[:-1], good.replace(b"\r\n", b"\n"), good * 2):
        refused(AssertionError, "", check_responses, bad, [exchange])
