"""Questions between workers, their messages, and tokens, which contain the worker of a play."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest
from hypothesis import given
from hypothesis import strategies as st

from server.abr.clientstatus import MAX_BODY_BYTES, TOKEN
from server.operate.workers.peers import MAX_MESSAGE_BYTES, Mailboxes, Peers
from server.operate.workers.playmessage import (
    MAX_TOKEN_AGE_S,
    PlayAnswer,
    PlayQuestion,
    is_issued,
    make_token,
    worker_of,
)
from tests.support.server.virtualtime import in_virtual_time, now_s, passes


@asynccontextmanager
async def group(count: int, timeout_s: float = 1.0) -> AsyncIterator[list[Peers]]:
    """Workers 0..count-1, and an empty place after them."""
    mailboxes = Mailboxes(count + 1)
    peers = [Peers(n, mailboxes, timeout_s) for n in range(count)]
    for n, one in enumerate(peers):
        one.on_request = lambda message, n=n: b"%d:" % n + message  # type: ignore[misc]
        one.start()
    try:
        yield peers
    finally:
        for one in peers:
            one.close()
        mailboxes.close()


@in_virtual_time
async def test_everybody_answers_everybody_even_itself() -> None:
    async with group(3) as peers:
        for asker in peers:
            for n in range(3):
                assert await asker.ask(n, b"hello") == b"%d:hello" % n
        assert peers[0].counts.asked == peers[0].counts.answered == 3
        burst = [peers[n % 2].ask(2, b"%d" % n) for n in range(200)]
        assert await asyncio.gather(*burst) == [b"2:%d" % n for n in range(200)]


@in_virtual_time
async def test_who_is_not_there_is_not_waited_for_long() -> None:
    async with group(2, timeout_s=0.3) as peers:
        began_s = now_s()
        assert await peers[0].ask(2, b"hello") is None
        assert now_s() - began_s == pytest.approx(0.3)
        assert await peers[0].ask(3, b"hello") is None
        assert await peers[0].ask(-1, b"hello") is None
        assert peers[0].counts.unanswered == 3
        # However many are sent to it, what waits is bounded.
        flood = (peers[0].ask(2, b"x") for _ in range(2000))
        assert await asyncio.gather(*flood) == [None] * 2000
        assert 1000 < peers[0].counts.dropped < 2000
        assert await peers[0].ask(1, b"hello") == b"1:hello"


@in_virtual_time
async def test_an_answer_that_fails_is_none(caplog: pytest.LogCaptureFixture) -> None:
    def fails(_: bytes) -> bytes:
        raise KeyError("bug")

    async with group(2, timeout_s=0.1) as peers:
        peers[1].on_request = fails
        assert await peers[0].ask(1, b"bug") is None
        peers[1].on_request = lambda message: message
        assert await peers[0].ask(1, b"hello") == b"hello"
    assert "from another worker failed" in caplog.text


@in_virtual_time
async def test_only_the_first_answer_counts_and_none_to_what_was_not_asked() -> None:
    mailboxes = Mailboxes(2)
    asker = Peers(0, mailboxes)
    asker.start()
    question = asyncio.create_task(asker.ask(1, b"hello"))
    await passes(0.01)
    head = mailboxes.inboxes[1].recv(100).removesuffix(b"hello")
    reply = b"\x02" + head[1:]
    other = reply[:-1] + bytes([reply[-1] ^ 1])
    for message in (other + b"other", reply + b"first", reply + b"second"):
        mailboxes.outboxes[0].send(message)
    assert await question == b"first"
    mailboxes.outboxes[0].send(reply + b"late")
    await passes(0.01)
    assert asker.counts.refused == 3
    asker.close()
    mailboxes.close()


SECRET = bytes(range(32))
NOW_S = 1_790_000_000.0


@given(st.integers(0, 511))
def test_a_token_tells_its_worker_and_nothing_else(number: int) -> None:
    token = make_token(number, SECRET, NOW_S)
    assert worker_of(token) == number
    assert re.fullmatch(TOKEN, token)
    assert token != make_token(number, SECRET, NOW_S)


@given(st.integers(0, 511), st.integers(0, 63), st.characters(codec="utf-8"))
def test_a_token_is_issued_by_a_server_with_its_secret(number: int, at: int, char: str) -> None:
    token = make_token(number, SECRET, NOW_S)
    assert is_issued(token, SECRET, NOW_S)
    assert not is_issued(token, bytes(32), NOW_S)
    at %= len(token)
    altered = token[:at] + char + token[at + 1 :]
    assert is_issued(altered, SECRET, NOW_S) == (altered == token)
    assert not is_issued(token[:-1], SECRET, NOW_S)
    assert not is_issued(token + "A", SECRET, NOW_S)


def test_a_token_is_too_old_after_a_day() -> None:
    token = make_token(1, SECRET, NOW_S)
    assert is_issued(token, SECRET, NOW_S + MAX_TOKEN_AGE_S - 1)
    assert not is_issued(token, SECRET, NOW_S + MAX_TOKEN_AGE_S)


@pytest.mark.parametrize(
    "token", ["", "3", "3-", "-3-" + "a" * 20, "03-" + "a" * 20, "x-" + "a" * 20, "3-" + "ä" * 20]
)
def test_a_token_of_nobody_has_no_worker(token: str) -> None:
    assert worker_of(token) is None


@given(st.text(max_size=64), st.text(max_size=80), st.none() | st.binary(max_size=MAX_BODY_BYTES))
def test_a_question_comes_as_it_was_sent(token: str, stream: str, body: bytes | None) -> None:
    question = PlayQuestion(token, stream, body)
    assert PlayQuestion.unpack(question.pack()) == question
    assert len(question.pack()) <= MAX_MESSAGE_BYTES


@given(st.text(max_size=20), st.none() | st.floats(0, 1e12), st.text(max_size=500))
def test_an_answer_comes_as_it_was_sent(outcome: str, rate_bps: float, problem: str) -> None:
    answer = PlayAnswer(outcome, rate_bps, problem)
    assert PlayAnswer.unpack(answer.pack()) == answer
    assert len(answer.pack()) <= MAX_MESSAGE_BYTES
