"""What workers ask each other about plays: news for one that runs elsewhere, and its client's rate.

A play's token begins with the number of the worker that runs it. Pure.
"""

from __future__ import annotations

import math
import re
import secrets
from dataclasses import dataclass
from typing import Any

import msgpack

from codec.errors import InvalidError
from server.abr.standing import MAX_BODY_BYTES

_TOKEN = re.compile(r"(0|[1-9][0-9]{0,2})-[A-Za-z0-9_-]{16,60}", re.ASCII)


def make_token(number: int) -> str:
    """A new token of a play in worker `number`: nobody can guess it."""
    return f"{number}-{secrets.token_urlsafe(16)}"


def worker_of(token: str) -> int | None:
    """The worker that made `token`; None where none can have."""
    match = _TOKEN.fullmatch(token)
    return int(match[1]) if match else None


@dataclass(frozen=True, slots=True)
class PlayQuestion:
    """News of a play; without a body, only what is known of its client."""

    token: str
    stream: str
    body: bytes | None = None

    def pack(self) -> bytes:
        packed: bytes = msgpack.packb((self.token, self.stream, self.body))
        return packed

    @classmethod
    def unpack(cls, data: bytes) -> PlayQuestion:
        """Raises InvalidError for what is not a question."""
        match _unpack(data):
            case [str(token), str(stream), bytes() | None as body] if (
                body is None or len(body) <= MAX_BODY_BYTES
            ):
                return cls(token, stream, body)
        raise InvalidError("a request from another worker is malformed")


@dataclass(frozen=True, slots=True)
class PlayAnswer:
    """What became of it."""

    outcome: str
    """What became of the news; empty where there were none."""
    rate_bps: float | None = None
    """The estimate of the client's link, where there is one."""
    problem: str = ""
    """What was wrong with the news."""

    def pack(self) -> bytes:
        packed: bytes = msgpack.packb((self.outcome, self.rate_bps, self.problem[:500]))
        return packed

    @classmethod
    def unpack(cls, data: bytes) -> PlayAnswer:
        """Raises InvalidError for what is not an answer."""
        match _unpack(data):
            case [str(outcome), float() | int() | None as rate_bps, str(problem)] if (
                rate_bps is None or (math.isfinite(rate_bps) and rate_bps >= 0)
            ):
                return cls(outcome, rate_bps, problem)
        raise InvalidError("a response from another worker is malformed")


def _unpack(data: bytes) -> Any:
    try:
        return msgpack.unpackb(data)
    except (ValueError, msgpack.UnpackException) as error:
        raise InvalidError("a message from another worker cannot be decoded") from error
