"""Requests that no honest client sends, over raw sockets to a real swings-serve."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.server.hostile.requestcases import CASES, OBJECT, Case
from tests.server.hostile.serverprocess import (
    SECRET,
    Answer,
    ServerProcess,
    answers_of,
    ask,
    exchange,
    server_process,
)
from tests.support.hosted_streams import write_stream
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


@pytest.fixture(scope="module")
def server(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServerProcess]:
    # Without a line for each request, so that any other line is noticed.
    log = tmp_path_factory.mktemp("log")
    with server_process(root, log, "--no-log-requests") as running:
        wait_until(lambda: "is served" in running.log.read_text())
        yield running


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
    case: Case, server: ServerProcess, root: Path
) -> None:
    whole = (root / "walk" / "segments" / "0" / "0").read_bytes()
    tag = ask(server.port, OBJECT).headers["etag"]
    before = len(server.log_lines())
    data, closed = exchange(server.port, case.sent.replace(b"ETAG", tag.encode()), case.shut)
    answers, rest = answers_of(data)
    statuses = [answer.status for answer in answers]
    assert not rest, f"not a response: {rest[:200]!r}"
    assert case.least <= len(answers) <= case.most, statuses
    assert set(statuses) <= set(case.statuses), (statuses, data[:300])
    assert closed or not case.closes, "the connection is kept, though nobody knows what comes next"
    assert SECRET not in data
    assert b"root:" not in data
    assert b"Traceback" not in data
    for answer in answers:
        check_bytes(answer, whole)
    written = server.settled_log(before)[before:]
    assert not any("Traceback" in line for line in written), written
    assert not written
    assert ask(server.port, "/healthz").status == 200


def test_each_request_is_one_line_of_the_log(root: Path, tmp_path: Path) -> None:
    with server_process(root, tmp_path) as server:
        tag = ask(server.port, OBJECT).headers["etag"].encode()
        num_answers = 1
        for case in CASES:
            data, _ = exchange(server.port, case.sent.replace(b"ETAG", tag), case.shut)
            num_answers += sum(answer.status != 100 for answer in answers_of(data)[0])
        time.sleep(0.5)  # lines are written in batches
        lines = [line for line in server.log_lines() if " request address=" in line]
    # A client that leaves gets no response, but a log line.
    assert num_answers <= len(lines) <= num_answers + len(CASES)
    assert all(line.isascii() and line.isprintable() for line in lines)


def test_a_poisoned_request_would_be_seen(server: ServerProcess) -> None:
    """The harness distinguishes two responses from one."""
    one = b"GET /healthz HTTP/1.1\r\nHost: h\r\n\r\n"
    data, closed = exchange(server.port, one + one)
    answers, rest = answers_of(data)
    assert [answer.status for answer in answers] == [200, 200]
    assert (rest, closed) == (b"", False)
