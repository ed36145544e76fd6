"""The query string of a /play: what a client wants of a stream.

Rule: every text gives a query or a 400 in one line that says what is allowed.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from server.abr.clientstatus import MAX_FRAME
from server.http.errors import RequestError

from .asked import parse_number

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
