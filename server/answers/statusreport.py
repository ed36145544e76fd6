"""POST /v1/streams/{stream}/play/{play}: a client reports its playback status.

Rule: a flood of reports costs only its requests. A play reads only the newest report, when it next
updates its session. If another worker runs the play, that worker is asked.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Coroutine
from typing import Any

from codec.errors import InvalidError
from server.abr.clientstatus import (
    LIVE_HEADER,
    NUM_FRAMES_HEADER,
    RATE_HEADER,
    RECEIVED_HEADER,
    REPORT_HEADER,
    ClientStatus,
)
from server.exchange.errors import RequestError
from server.exchange.response import Response
from server.operate.workers.playmessage import (
    PlayAnswer,
    PlayQuestion,
    issue_time_s,
    worker_of,
)
from server.state.register import CONTINUE_S, Continuation, StatusOutcome
from server.state.serverstate import ServerState

from .call import Call

END_S = 1.0
"""Seconds that a play has to end when its client asks to continue it."""

LOOK_S = 0.05
"""How often it is looked whether it has ended, seconds."""


def answer_status(call: Call) -> Response | Coroutine[Any, Any, Response]:
    """204, or an error that says what is wrong with it."""
    state, token = call.state, call.names["play"]
    stream, body, place = call.name("stream"), call.request.body, worker_of(token)
    if state.peers is not None and place is not None and place != state.number:
        return _ask(call, place, PlayQuestion(token, stream, body))
    return _response(call, _report(state, token, stream, body))


async def ask_rate_bps(state: ServerState, token: str, now_s: float) -> float | None:
    """The estimated rate of the play `token`, asked of the worker that runs or ran it; None if that
    worker has no estimate or does not answer."""
    place = worker_of(token)
    if state.peers is None or place is None or place == state.number:
        return state.plays.rate_bps(token, now_s)
    answer = await state.peers.ask(place, PlayQuestion(token, "").pack())
    return PlayAnswer.unpack(answer).rate_bps if answer else None


async def may_continue(state: ServerState, token: str) -> bool:
    """Whether a new play may continue that of `token`, which this server has issued: once, and soon
    after its end. A play that still runs has END_S to end, as its client may have left it just
    now."""
    clock = asyncio.get_running_loop().time
    end_s = clock() + END_S
    while (outcome := await _continued(state, token, clock())) == Continuation.RUNNING:
        if clock() >= end_s:
            return False
        await asyncio.sleep(LOOK_S)
    return outcome == Continuation.ALLOWED


async def _continued(state: ServerState, token: str, now_s: float) -> str:
    """What the worker that runs or ran the play says; where it does not answer, it has died."""
    place = worker_of(token)
    if state.peers is None or place is None or place == state.number:
        return _continued_here(state, token, now_s)
    answer = await state.peers.ask(place, PlayQuestion(token, "", None, True).pack())
    if answer is None:
        return state.plays.continue_play(token, now_s, is_lost=True)
    return PlayAnswer.unpack(answer).outcome


def _continued_here(state: ServerState, token: str, now_s: float) -> str:
    # Of a predecessor of this worker, which had the same number and died, nothing is known.
    is_new = time.time() <= state.began_s + CONTINUE_S
    is_lost = is_new and issue_time_s(token) < state.began_s - 1
    return state.plays.continue_play(token, now_s, is_lost)


def answer_peer(state: ServerState, question: bytes, now_s: float) -> bytes:
    """The packed PlayAnswer to another worker's PlayQuestion."""
    asked = PlayQuestion.unpack(question)
    if asked.continues:
        return PlayAnswer(_continued_here(state, asked.token, now_s)).pack()
    if asked.body is None:
        return PlayAnswer("", state.plays.rate_bps(asked.token, now_s)).pack()
    return _report(state, asked.token, asked.stream, asked.body).pack()


async def _ask(call: Call, place: int, question: PlayQuestion) -> Response:
    peers = call.state.peers
    assert peers is not None
    answer = await peers.ask(place, question.pack())
    # A worker that has died, or begun anew, runs no such play.
    unknown = PlayAnswer(StatusOutcome.UNKNOWN)
    return _response(call, PlayAnswer.unpack(answer) if answer else unknown)


def _report(state: ServerState, token: str, stream: str, body: bytes) -> PlayAnswer:
    plays = state.plays
    entry = plays.find(token, stream)
    if entry is None:
        return PlayAnswer(StatusOutcome.UNKNOWN)
    try:
        status = ClientStatus.from_json(body)
    except InvalidError as error:
        return PlayAnswer(StatusOutcome.REFUSED, problem=str(error))
    outcome = plays.report(token, stream, status)
    return PlayAnswer(
        outcome, entry.rate_bps, report_s=entry.report_s, received_bytes=entry.received_bytes
    )


def _response(call: Call, answer: PlayAnswer) -> Response:
    call.state.metrics.status_reports.add(1, answer.outcome)
    if answer.outcome == StatusOutcome.REFUSED:
        raise RequestError(400, f"client status of a play: {answer.problem}")
    if answer.outcome == StatusOutcome.UNKNOWN:
        raise RequestError(404, "no such play, or it has ended")
    fields = {"Cache-Control": "no-store"}
    if answer.rate_bps is not None:
        fields[RATE_HEADER] = str(round(answer.rate_bps))
    if answer.report_s:
        fields[REPORT_HEADER] = str(round(1000 * answer.report_s))
    if answer.received_bytes:
        fields[RECEIVED_HEADER] = str(round(answer.received_bytes))
    # A play is sent a few seconds ahead, and no further while it is paused: only here its client
    # learns where the live edge is.
    stream = call.state.library.streams.get(call.name("stream"))
    if stream is not None:
        fields[NUM_FRAMES_HEADER] = str(stream.num_frames)
        fields[LIVE_HEADER] = str(int(stream.live))
    return Response(204, fields)
