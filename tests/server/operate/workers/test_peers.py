"""Questions between workers: on one event loop, and between real processes that die."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from server.operate.workers.peers import Mailboxes, Peers
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
