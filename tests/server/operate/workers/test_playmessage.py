"""Messages about plays, and the tokens that tell where they run."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from server.abr.standing import MAX_BODY_BYTES, TOKEN
from server.operate.workers.peers import MAX_MESSAGE_BYTES
from server.operate.workers.playmessage import PlayAnswer, PlayQuestion, make_token, worker_of


@given(st.integers(0, 511))
def test_a_token_tells_its_worker_and_nothing_else(number: int) -> None:
    token = make_token(number)
    assert worker_of(token) == number
    assert re.fullmatch(TOKEN, token)
    assert token != make_token(number)


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


@given(st.binary(max_size=200))
def test_any_bytes_are_a_message_or_refused(data: bytes) -> None:
    for kind in (PlayQuestion, PlayAnswer):
        try:
            message = kind.unpack(data)
        except InvalidError:
            continue
        assert kind.unpack(message.pack()) == message


def test_values_of_other_types_are_refused() -> None:
    import msgpack

    for wrong in (None, [], ["a", "b"], ["a", 1, b""], ["a", "b", b"x" * 3000], {"a": 1}):
        with pytest.raises(InvalidError):
            PlayQuestion.unpack(msgpack.packb(wrong))
    for wrong in (["a", float("nan"), ""], ["a", -1.0, ""], ["a", True, 5], [1, 1.0, ""]):
        with pytest.raises(InvalidError):
            PlayAnswer.unpack(msgpack.packb(wrong))
