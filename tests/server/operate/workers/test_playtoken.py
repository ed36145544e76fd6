"""Tokens of plays, and how a worker asks the one that a token names."""

from __future__ import annotations

import asyncio
import re
from collections import Counter
from pathlib import Path

import pytest
from aiohttp import web
from hypothesis import given
from hypothesis import strategies as st

from server.abr.clientstatus import TOKEN
from server.listener import BACKLOG
from server.operate.workers import (
    MAX_TOKEN_AGE_S,
    MAX_WAITING,
    OtherWorkers,
    is_issued,
    make_token,
    worker_of,
)
from tests.support.waiting import BOUND_S

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


@pytest.mark.anyio
async def test_a_worker_that_does_not_answer_is_not_waited_for(
    tmp_path: Path,
) -> None:
    asked, outcomes = asyncio.Semaphore(0), Counter[str]()

    async def answer(request: web.Request) -> web.Response:
        asked.release()
        if request.path == "/hang":
            await asyncio.Event().wait()
        return web.Response(status=201, body=await request.read(), headers={"X": "y"})

    def other_workers(timeout_s: float) -> OtherWorkers:
        return OtherWorkers(tmp_path, 0, lambda outcome: outcomes.update([outcome]), timeout_s)

    workers, late = other_workers(BOUND_S), other_workers(0.01)
    app = web.Application()
    app.router.add_post("/{path}", answer)
    runner = web.AppRunner(app, shutdown_timeout=0.01)
    await runner.setup()
    await web.UnixSite(runner, str(workers.path(1)), backlog=BACKLOG).start()
    answered = await workers.ask(1, "/here", b"body")
    assert answered is not None
    assert (answered.status, answered.headers["X"], answered.body) == (201, "y", b"body")
    assert await workers.ask(2, "/nobody") is None
    # However many are asked of it, what waits is bounded.
    hanging = [asyncio.create_task(workers.ask(1, "/hang")) for _ in range(MAX_WAITING)]
    async with asyncio.timeout(BOUND_S):
        for _ in range(MAX_WAITING + 1):
            await asked.acquire()
    assert await workers.ask(1, "/here") is None
    for task in hanging:
        task.cancel()
    await asyncio.wait(hanging)
    assert await late.ask(1, "/hang") is None
    assert outcomes == {"answered": 1, "unanswered": 3}
    for one in (workers, late):
        await one.close()
    await runner.cleanup()
