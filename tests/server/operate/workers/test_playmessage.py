"""Messages about plays, and tokens, which contain the worker of a play."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from server.abr.clientstatus import MAX_BODY_BYTES, TOKEN
from server.operate.workers.peers import MAX_MESSAGE_BYTES
from server.operate.workers.playmessage import (
    MAX_TOKEN_AGE_S,
    PlayAnswer,
    PlayQuestion,
    is_issued,
    make_token,
    worker_of,
)

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
