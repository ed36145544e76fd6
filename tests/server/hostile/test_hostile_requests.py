"""Requests that no honest client sends, over raw sockets to a real swings-serve."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.server.hostile.requestcases import CASES, OBJECT, Case
from tests.server.hostile.serverprocess import (
    SECRET,
    ServerProcess,
    answers_of,
    ask,
    exchange,
    server_process,
)
from tests.support.hosted_streams import write_stream
from tests.support.server.running_server import Answer
from tests.support.waiting import wait_until


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of streams, with secret files in it and around it."""
    top = tmp_path_factory.mktemp("hostile")
    root = top / "root"
    stream = write_stream(root / "walk", 12)
    write_stream(root / ".hidden", 12)
    for folder in (top, root, stream, stream / "segments"):
        (folder / "secret.png").write_bytes(SECRET)
    return root


@dataclass
class Asked:
    """A server, and how much it was asked so far."""

    server: ServerProcess
    tag: bytes
    """Of the object."""
    num_cases: int = 0
    num_answers: int = 0


@pytest.fixture(scope="module")
def asked(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Asked]:
    """In its log, each request is one line, and nothing else is in it."""
    # What follows an upgrade is not read: such a connection ends by being idle.
    options = "--keepalive-timeout-s", 3, "--log-requests", "all"
    with server_process(root, tmp_path_factory.mktemp("log"), *options) as server:
        wait_until(lambda: "is served" in server.log.read_text())
        num_before = len(server.log_lines())
        asked = Asked(server, ask(server.port, OBJECT).headers["etag"].encode(), num_answers=1)
        yield asked
    lines = server.log_lines()[num_before:]
    assert all(" request address=" in line for line in lines), lines
    assert all(line.isascii() and line.isprintable() for line in lines)
    # A client that leaves gets no response, but a log line.
    assert asked.num_answers <= len(lines) <= asked.num_answers + asked.num_cases


def check_bytes(answer: Answer, whole: bytes) -> None:
    """Asserts that a response with a part of the object has exactly that part."""
    if answer.headers.get("content-type") != "application/octet-stream":
        return
    if answer.status == 200:
        assert answer.body == whole
    elif answer.status == 206:
        found = re.fullmatch(r"bytes (\d+)-(\d+)/(\d+)", answer.headers["content-range"])
        assert found
        assert answer.body == whole[int(found[1]) : int(found[2]) + 1]
        assert int(found[3]) == len(whole)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_it_is_answered_as_http_says_and_nothing_else_happens(
    case: Case, asked: Asked, root: Path
) -> None:
    whole = (root / "walk" / "segments" / "0" / "0").read_bytes()
    data, closed = exchange(asked.server.port, case.sent.replace(b"ETAG", asked.tag), case.shut)
    answers, rest = answers_of(data)
    asked.num_cases += 1
    asked.num_answers += sum(answer.status != 100 for answer in answers) + (not closed)
    statuses = [answer.status for answer in answers]
    assert not rest, f"not a response: {rest[:200]!r}"
    assert case.least <= len(answers) <= case.most, statuses
    assert set(statuses) <= set(case.statuses), (statuses, data[:300])
    wrong = [answer.headers.get("content-type", "") for answer in answers if answer.status >= 400]
    assert not any(kind.startswith("text/plain") for kind in wrong)
    assert closed or not case.closes, "the connection is kept, though nobody knows what comes next"
    assert SECRET not in data
    assert b"root:" not in data
    assert b"Traceback" not in data
    for answer in answers:
        check_bytes(answer, whole)


def test_a_poisoned_request_would_be_seen(asked: Asked) -> None:
    """The harness distinguishes two responses from one."""
    one = b"GET /healthz HTTP/1.1\r\nHost: h\r\n\r\n"
    data, closed = exchange(asked.server.port, one + one)
    answers, rest = answers_of(data)
    asked.num_answers += 3
    assert [answer.status for answer in answers] == [200, 200]
    assert (rest, closed) == (b"", False)
