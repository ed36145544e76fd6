"""The status of a client's playback, as it reports it to the server; JSON on the wire.

Rule: both sides use this file. Input is checked completely, so a `ClientStatus` is always valid,
though not always true."""

from __future__ import annotations

import json
from dataclasses import dataclass

from codec.errors import InvalidError

PLAY_HEADER = "Swings-Play"
"""In the response of a play: the token with which its client reports its status. In a request: the
token of the client's previous play, whose rate is the new play's first estimate."""

FRAME_HEADER = "Swings-Frame"
"""In a request for a play by a returning client that still has frames buffered: the next frame that
it will show."""

RATE_HEADER = "Swings-Rate"
"""In the answer to a status report: the estimated rate of the link, bits per second. In a request
for a play: the last such rate, for a server that has lost it."""

REPORT_HEADER = "Swings-Report-Ms"
"""In the response of a play, and in the answers to its status reports: the time after which the
server wants the next one, where it measures by them, milliseconds."""

NUM_FRAMES_HEADER = "Swings-Frames"
"""In the answer to a status report: how many frames the stream has."""

LIVE_HEADER = "Swings-Live"
"""The same: 1 if more frames may follow, 0 if not."""

MOST_RATE_BPS = 10**12

MAX_POINTS = 24
"""Most points in `ClientStatus.received`."""

MAX_POINT = 2**53 - 1

TOKEN = "[A-Za-z0-9_-]{1,64}"
"""Regular expression of a token."""

MAX_BODY_BYTES = 1024
"""The longest text that is read."""

MAX_FRAME = 2**31 - 1

MAX_BUFFER_S = 86_400

MAX_REPORT_MS = 10_000

_KEYS = ("frame", "buffer_s", "paused", "busy", "received")


def parse_rate(text: str) -> float | None:
    """The bits per second that the value of a RATE_HEADER says; None where it says none."""
    if not (text.isascii() and text.isdigit() and len(text) <= 13):
        return None
    return float(text) if 0 < int(text) <= MOST_RATE_BPS else None


def parse_frame(text: str) -> int | None:
    """The frame that the value of a FRAME_HEADER names; None where it names none."""
    if not (text.isascii() and text.isdigit() and len(text) <= 10):
        return None
    return int(text) if int(text) <= MAX_FRAME else None


def parse_report_s(text: str) -> float | None:
    """The seconds between two reports that the value of a REPORT_HEADER wants; None for none."""
    if not (text.isascii() and text.isdigit() and len(text) <= 5):
        return None
    return min(int(text), MAX_REPORT_MS) / 1e3 or None


@dataclass(frozen=True, slots=True)
class ClientStatus:
    """A client's report of its playback."""

    frame: int | None = None
    """The next frame that it will show."""
    buffer_s: float | None = None
    """Seconds of media that it holds ready. Without `frame`, this says where it is."""
    paused: bool = False
    """Whether its time stands still."""
    busy: bool = False
    """Whether it does not read, for reasons of its own."""
    received: tuple[tuple[int, int], ...] = ()
    """When it had how much of the play's body: milliseconds of its own clock, and bytes without the
    content coding; the last one is the newest."""

    def __post_init__(self) -> None:
        frame, buffer_s = self.frame, self.buffer_s
        if frame is None and buffer_s is None:
            raise InvalidError("frame and buffer_s are both missing; give one of them")
        # A bool is an int, and NaN is within no limits.
        if frame is not None and not (type(frame) is int and 0 <= frame <= MAX_FRAME):
            raise InvalidError(f"frame is not a whole number from 0 to {MAX_FRAME}")
        if buffer_s is not None and not (
            type(buffer_s) in (int, float) and 0 <= buffer_s <= MAX_BUFFER_S
        ):
            raise InvalidError(f"buffer_s is not a number from 0 to {MAX_BUFFER_S}")
        for key in ("paused", "busy"):
            if type(getattr(self, key)) is not bool:
                raise InvalidError(f"{key} is neither true nor false")
        if len(self.received) > MAX_POINTS:
            raise InvalidError(f"received has more than {MAX_POINTS} points")
        for point in self.received:
            if not (
                len(point) == 2
                and all(type(number) is int and 0 <= number <= MAX_POINT for number in point)
            ):
                raise InvalidError("received is not a list of pairs of milliseconds and bytes")

    def to_json(self) -> bytes:
        fields = {key: getattr(self, key) for key in _KEYS}
        return json.dumps(
            {key: v for key, v in fields.items() if v is not None and v != ()}
        ).encode()

    @classmethod
    def from_json(cls, data: bytes) -> ClientStatus:
        """Parses and checks `data`. Raises InvalidError with a line for the client."""
        if len(data) > MAX_BODY_BYTES:
            raise InvalidError(f"the body has more than {MAX_BODY_BYTES} bytes")
        try:
            value = json.loads(data.decode())
        except (ValueError, RecursionError) as error:
            raise InvalidError("the body is not JSON in UTF-8") from error
        if not isinstance(value, dict):
            raise InvalidError('the body is not a JSON object such as {"frame": 70}')
        for key in value:
            if key not in _KEYS:
                raise InvalidError(f"unknown key {key[:40]!a}; the keys are {', '.join(_KEYS)}")
            if value[key] is None:
                raise InvalidError(f"{key} is null; leave it out")
        received = value.pop("received", [])
        if not (isinstance(received, list) and all(isinstance(one, list) for one in received)):
            raise InvalidError("received is not a list of pairs of milliseconds and bytes")
        return cls(**value, received=tuple(map(tuple, received)))
