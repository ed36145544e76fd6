"""Helpers of all handlers: the stream that a URL names, room for a play, and the query string of a
/play.

Rule: every text gives a query or a 400 in one line that says what is allowed.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from aiohttp import web

from server.abr.clientstatus import MAX_FRAME
from server.http.errors import RequestError
from server.http.requestlog import WAITS_FROM_S, address_of
from server.library import ServedStream
from server.state.serverstate import STATE

RETRY_AFTER_S = 5
"""Seconds after which a refused client may ask again."""

STREAM = "/v1/streams/{stream}"
"""How the routes of a stream begin."""


def stream_of(request: web.Request) -> ServedStream:
    """The stream that the URL names. Raises RequestError 404 where there is none."""
    name = request.match_info["stream"]
    stream = request.app[STATE].library.streams.get(name)
    if stream is None:
        raise RequestError(404, f"no stream is named {name[:80]!a}; /v1/streams lists all")
    return stream


def parse_number(key: str, text: str, most: int) -> int:
    """A number of a query. Raises RequestError 400 for what is none from 0 to `most`."""
    if not (text.isascii() and text.isdigit() and len(text) <= 10 and int(text) <= most):
        raise RequestError(400, f"{key}={text[:40]!a} is not a number from 0 to {most}")
    return int(text)


def waits(request: web.Request) -> None:
    """Has the time from now to the first byte of the response be measured."""
    request[WAITS_FROM_S] = asyncio.get_running_loop().time()


@contextmanager
def room_for_play(request: web.Request, continues: bool = False) -> Iterator[None]:
    """Holds a play's place for the client. Raises RequestError 503 if there may not be one more
    play, 429 if this client may not have one more. continues: see `Overload.accepts_plays`."""
    state = request.app[STATE]
    if state.stopping.is_set():
        raise RequestError(503, "the server is stopping", {"Retry-After": str(RETRY_AFTER_S)})
    if not state.overload.accepts_plays(len(state.plays), continues):
        state.metrics.refused.add(1, "play_load")
        message = f"the server is full, with {len(state.plays)} plays; try again later"
        after_s = max(RETRY_AFTER_S, state.overload.retry_after_s)
        raise RequestError(503, message, {"Retry-After": str(after_s)})
    address = address_of(request, state.proxies)
    refusal = state.play_admission.admit(address)
    if refusal is not None:
        state.metrics.refused.add(1, f"play_{refusal}")
        message = "too many plays from this address; try again later"
        raise RequestError(429, message, {"Retry-After": str(RETRY_AFTER_S)})
    try:
        yield
    finally:
        state.play_admission.release(address)


_KEYS = ("from", "until", "layers", "paused", "reports")

LIVE = "live"
"""In place of the first frame: the newest that can be begun with."""


@dataclass(frozen=True, slots=True)
class PlayQuery:
    """The parsed query string of a play."""

    from_frame: int
    until_frame: int | None
    """First frame that is not wanted; None for all."""
    num_layers: int | None
    """A fixed number of layers; None for the server's choice."""
    paused: bool = False
    """Whether the client begins with a still picture."""
    reports: bool = False
    """Whether the client's status reports say what it has received."""


def parse_query(
    pairs: Iterable[tuple[str, str]],
    num_frames: int,
    live: bool,
    num_layers: int,
    edge_frame: int = 0,
) -> PlayQuery:
    """The checked query. edge_frame: first frame of a play that asks for the live edge. Raises
    RequestError 400 with the allowed values."""
    values: dict[str, str] = {}
    for key, value in pairs:
        if key not in _KEYS or key in values:
            raise RequestError(
                400, f"{key[:40]!r}: play accepts only {', '.join(_KEYS)}, each once"
            )
        values[key] = value
    flags = [_flag(key, values.get(key, "0")) for key in ("paused", "reports")]
    text = values.get("from", "0")
    from_frame = edge_frame if text == LIVE else parse_number("from", text, MAX_FRAME)
    # A live stream may be joined before it has its first segment.
    if from_frame >= (num_frames or int(live)):
        raise RequestError(
            400, f"from={from_frame}: the stream has {num_frames} frames; count from 0"
        )
    until_frame = None
    if "until" in values:
        until_frame = parse_number("until", values["until"], MAX_FRAME)
        if until_frame <= from_frame:
            raise RequestError(400, f"until={until_frame} must be greater than from={from_frame}")
    layers = values.get("layers", "auto")
    if layers == "auto":
        return PlayQuery(from_frame, until_frame, None, *flags)
    fixed = num_layers if layers == "all" else parse_number("layers", layers, MAX_FRAME)
    if not 1 <= fixed <= num_layers:
        raise RequestError(400, f"layers={fixed}: give auto, all or 1 to {num_layers}")
    return PlayQuery(from_frame, until_frame, fixed, *flags)


def _flag(key: str, text: str) -> bool:
    if text not in ("0", "1"):
        raise RequestError(400, f"{key}={text[:40]!r}: give 0 or 1")
    return text == "1"
