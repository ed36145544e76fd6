"""POST /v1/streams/{stream}/play/{play}: a client tells how its playback stands.

Rule: a flood of news costs what its requests cost, and no more. The play looks at the newest only,
when it would look at its client anyway. A play may run in another worker, which is asked.
"""

from __future__ import annotations

from collections.abc import Coroutine
from typing import Any

from codec.errors import InvalidError
from server.abr.standing import RATE_HEADER, Standing
from server.http.errors import RequestError
from server.http.response import Response
from server.operate.workers.playmessage import PlayAnswer, PlayQuestion, worker_of
from server.state.register import NewsOutcome
from server.state.serverstate import ServerState

from .call import Call


def take_news(call: Call) -> Response | Coroutine[Any, Any, Response]:
    """204, or an error that says what is wrong with it."""
    state, token = call.state, call.names["play"]
    stream, body, place = call.name("stream"), call.request.body, worker_of(token)
    if state.peers is not None and place is not None and place != state.number:
        return _ask(call, place, PlayQuestion(token, stream, body))
    return _response(call, _tell(state, token, stream, body))


async def ask_rate_bps(state: ServerState, token: str, now_s: float) -> float | None:
    """What is known of the link of the play `token`, in whichever worker it runs or ran."""
    place = worker_of(token)
    if state.peers is None or place is None or place == state.number:
        return state.plays.rate_bps(token, now_s)
    answer = await state.peers.ask(place, PlayQuestion(token, "").pack())
    return PlayAnswer.unpack(answer).rate_bps if answer else None


def answer_peer(state: ServerState, question: bytes, now_s: float) -> bytes:
    """What another worker is answered."""
    asked = PlayQuestion.unpack(question)
    if asked.body is None:
        return PlayAnswer("", state.plays.rate_bps(asked.token, now_s)).pack()
    return _tell(state, asked.token, asked.stream, asked.body).pack()


async def _ask(call: Call, place: int, question: PlayQuestion) -> Response:
    peers = call.state.peers
    assert peers is not None
    answer = await peers.ask(place, question.pack())
    # A worker that has died, or begun anew, runs no such play.
    unknown = PlayAnswer(NewsOutcome.UNKNOWN)
    return _response(call, PlayAnswer.unpack(answer) if answer else unknown)


def _tell(state: ServerState, token: str, stream: str, body: bytes) -> PlayAnswer:
    plays = state.plays
    entry = plays.find(token, stream)
    if entry is None:
        return PlayAnswer(NewsOutcome.UNKNOWN)
    try:
        news = Standing.from_json(body)
    except InvalidError as error:
        return PlayAnswer(NewsOutcome.REFUSED, problem=str(error))
    return PlayAnswer(plays.tell(token, stream, news), entry.rate_bps)


def _response(call: Call, answer: PlayAnswer) -> Response:
    call.state.metrics.play_news.add(1, answer.outcome)
    if answer.outcome == NewsOutcome.REFUSED:
        raise RequestError(400, f"client status of a play: {answer.problem}")
    if answer.outcome == NewsOutcome.UNKNOWN:
        raise RequestError(404, "no such play, or it has ended")
    fields = {"Cache-Control": "no-store"}
    if answer.rate_bps is not None:
        fields[RATE_HEADER] = str(round(answer.rate_bps))
    return Response(204, fields)
