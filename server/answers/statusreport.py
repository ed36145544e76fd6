"""POST /v1/streams/{stream}/play/{play}: a client reports its playback status.

Rule: a flood of reports costs only its requests. A play reads only the newest report, when it next
updates its session. If another worker runs the play, that worker answers.
"""

from __future__ import annotations

import asyncio
import json
import time
from urllib.parse import quote

from aiohttp import web

from codec.errors import InvalidError
from server.abr.clientstatus import (
    LIVE_HEADER,
    MAX_BODY_BYTES,
    NUM_FRAMES_HEADER,
    RATE_HEADER,
    REPORT_HEADER,
    TOKEN,
    ClientStatus,
)
from server.http.content import NO_STORE
from server.http.errors import RequestError
from server.operate.workers import OtherWorkers, issue_time_s, worker_of
from server.state.register import CONTINUE_S, Continuation, StatusOutcome
from server.state.serverstate import STATE, ServerState

from .asked import STREAM

END_S = 1.0
"""Seconds that a play has to end when its client asks to continue it."""

LOOK_S = 0.05
"""How often it is looked whether it has ended, seconds."""

_TOLD = (RATE_HEADER, REPORT_HEADER, NUM_FRAMES_HEADER, LIVE_HEADER)
"""Headers of the answer to a status report."""

routes = web.RouteTableDef()

worker_routes = web.RouteTableDef()
"""What only the other workers ask, besides status reports."""


async def expect(request: web.Request) -> None:
    """Lets a client wait that wants to be asked for its body, see `_body`."""
    if request.headers["Expect"].lower() != "100-continue":
        raise RequestError(417, "100-continue is the only supported expectation")


@routes.post(f"{STREAM}/play/{{play:{TOKEN}}}", expect_handler=expect)
async def answer_status(request: web.Request) -> web.Response:
    """204, or an error that says what is wrong with it."""
    state, found = request.app[STATE], request.match_info
    token, name = found["play"], found["stream"]
    body = await _body(request, state.config.timeouts.keepalive_timeout_s)
    other = _runs_elsewhere(state, token)
    if other is not None:
        return await _passed_on(*other, f"/v1/streams/{quote(name, safe='')}/play/{token}", body)
    return _report(state, token, name, body)


async def _body(request: web.Request, timeout_s: float) -> bytes:
    """The body. Raises RequestError for one that is too long, or does not come."""
    if "Transfer-Encoding" in request.headers:
        error = RequestError(411, "send a Content-Length, not a Transfer-Encoding")
    elif (request.content_length or 0) > MAX_BODY_BYTES:
        error = RequestError(413, f"the body may have at most {MAX_BODY_BYTES} bytes here")
    else:
        if "Expect" in request.headers and request.transport is not None:
            request.transport.write(b"HTTP/1.1 100 Continue\r\n\r\n")
        try:
            async with asyncio.timeout(timeout_s):
                return await request.read()
        except TimeoutError:
            request.app[STATE].metrics.timeouts.add(1, "body")
            error = RequestError(408, "the request was not complete in time")
    error.force_close()  # nobody knows where the next request begins
    raise error


def _runs_elsewhere(state: ServerState, token: str) -> tuple[OtherWorkers, int] | None:
    """The other workers, and which of them runs or ran a play; None if it is this one, or none."""
    place = worker_of(token)
    if state.workers is None or place is None or place == state.workers.number:
        return None
    return state.workers, place


async def _passed_on(workers: OtherWorkers, place: int, path: str, body: bytes) -> web.Response:
    """The response of the worker that runs the play."""
    answer = await workers.ask(place, path, body)
    if answer is None:  # it has died, or begun anew: it runs no such play
        raise RequestError(404, "no such play, or it has ended")
    if answer.status >= 400:
        raise RequestError(answer.status, json.loads(answer.body)["error"])
    told = {name: answer.headers[name] for name in _TOLD if name in answer.headers}
    return web.Response(status=answer.status, headers={"Cache-Control": NO_STORE, **told})


def _report(state: ServerState, token: str, name: str, body: bytes) -> web.Response:
    """The response to the report of a play that this worker runs."""
    plays, outcomes = state.plays, state.metrics.status_reports
    entry = plays.find(token, name)
    if entry is None:
        outcomes.add(1, StatusOutcome.UNKNOWN)
        raise RequestError(404, "no such play, or it has ended")
    try:
        status = ClientStatus.from_json(body)
    except InvalidError as error:
        outcomes.add(1, StatusOutcome.REFUSED)
        raise RequestError(400, f"client status of a play: {error}") from error
    outcomes.add(1, plays.report(token, name, status))
    headers = {"Cache-Control": NO_STORE}
    if entry.rate_bps is not None:
        headers[RATE_HEADER] = str(round(entry.rate_bps))
    if entry.report_s:
        headers[REPORT_HEADER] = str(round(1000 * entry.report_s))
    # A play is sent a few seconds ahead, and no further while it is paused: only here its client
    # learns where the live edge is.
    stream = state.library.streams.get(name)
    if stream is not None:
        headers[NUM_FRAMES_HEADER] = str(stream.num_frames)
        headers[LIVE_HEADER] = str(int(stream.live))
    return web.Response(status=204, headers=headers)


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
    other = _runs_elsewhere(state, token)
    if other is None:
        return _continued_here(state, token, now_s)
    workers, place = other
    answer = await workers.ask(place, f"/plays/{token}/continued")
    if answer is None:
        return state.plays.continue_play(token, now_s, is_lost=True)
    return answer.body.decode()


def _continued_here(state: ServerState, token: str, now_s: float) -> str:
    # Of a predecessor of this worker, which had the same number and died, nothing is known.
    is_new = time.time() <= state.began_s + CONTINUE_S
    is_lost = is_new and issue_time_s(token) < state.began_s - 1
    return state.plays.continue_play(token, now_s, is_lost)


@worker_routes.post(f"/plays/{{play:{TOKEN}}}/continued")
async def answer_continued(request: web.Request) -> web.Response:
    """Whether a play of this worker may be continued: a Continuation."""
    now_s = asyncio.get_running_loop().time()
    outcome = _continued_here(request.app[STATE], request.match_info["play"], now_s)
    return web.Response(text=outcome)
