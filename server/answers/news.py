"""POST /v1/streams/{stream}/play/{play}: a client tells how its playback stands.

Rule: a flood of news costs what its requests cost, and no more. The play looks at the newest only,
when it would look at its client anyway. A play may run in another worker, which is asked.
"""

from __future__ import annotations

import json
from collections.abc import Coroutine
from dataclasses import dataclass
from typing import Any

from codec.errors import InvalidError
from server.abr.standing import RATE_HEADER, Standing
from server.http.errors import RequestError
from server.http.response import Response
from server.state.register import NewsOutcome, PlayRegister
from server.state.serverstate import ServerState

from .call import Call


@dataclass(frozen=True, slots=True)
class _Reply:
    """What became of news."""

    outcome: NewsOutcome
    error: str = ""
    """What is wrong with it, where it was refused."""
    rate_bps: float | None = None
    """What the link of the play is taken to carry."""


def take_news(call: Call) -> Response | Coroutine[Any, Any, Response]:
    """204, or an error that says what is wrong with it."""
    state, token, stream = call.state, call.names["play"], call.name("stream")
    place, _, rest = token.partition("-")
    if state.peers is not None and rest and place.isdigit() and int(place) != state.number:
        return _ask(call, int(place), token, stream)
    return _response(call, _tell(state.plays, token, stream, call.request.body))


async def _ask(call: Call, place: int, token: str, stream: str) -> Response:
    """The same of a play that another worker runs."""
    peers = call.state.peers
    assert peers is not None
    question = json.dumps([token, stream, call.request.body.decode("latin-1")]).encode()
    try:
        answer = await peers.ask(place, question)
    except InvalidError:  # nothing that is news has so many bytes
        answer = None
    reply = _Reply(NewsOutcome.UNKNOWN)
    if answer:
        outcome, error, rate_bps = json.loads(answer)
        reply = _Reply(NewsOutcome(outcome), error, rate_bps)
    return _response(call, reply)


def answer_peer(state: ServerState, question: bytes) -> bytes:
    """What another worker is answered that has news of a play of this one."""
    token, stream, body = json.loads(question)
    reply = _tell(state.plays, token, stream, body.encode("latin-1"))
    return json.dumps([reply.outcome, reply.error, reply.rate_bps]).encode()


def _tell(plays: PlayRegister, token: str, stream: str, body: bytes) -> _Reply:
    entry = plays.find(token, stream)
    if entry is None:
        return _Reply(NewsOutcome.UNKNOWN)
    try:
        news = Standing.from_json(body)
    except InvalidError as error:
        return _Reply(NewsOutcome.REFUSED, str(error))
    return _Reply(plays.tell(token, stream, news), "", entry.rate_bps)


def _response(call: Call, reply: _Reply) -> Response:
    call.state.metrics.play_news.add(1, reply.outcome)
    if reply.outcome is NewsOutcome.REFUSED:
        raise RequestError(400, f"news of a play: {reply.error}")
    if reply.outcome is NewsOutcome.UNKNOWN:
        raise RequestError(404, "there is no such play, or it is over")
    fields = {"Cache-Control": "no-store"}
    if reply.rate_bps is not None:
        fields[RATE_HEADER] = str(round(reply.rate_bps))
    return Response(204, fields)
