"""The token of a play: it begins with the number of the worker that runs the play, and ends with an
HMAC, so that only this server, all of whose workers share one secret, can have issued it. Pure."""

from __future__ import annotations

import hmac
import re
import secrets
from base64 import urlsafe_b64encode

_TOKEN = re.compile(r"(0|[1-9][0-9]{0,2})-[A-Za-z0-9_-]{16,60}", re.ASCII)

_ISSUED = re.compile(r"[0-9]{1,3}-([0-9a-f]{9})[A-Za-z0-9_-]{42}", re.ASCII)

MAX_TOKEN_AGE_S = 86_400
"""Age at which a token can no longer continue a play, seconds."""

_MAC_BYTES = 15

_MAC_CHARS = 20
"""Length of an HMAC of _MAC_BYTES in base64."""


def make_token(number: int, secret: bytes, now_s: float) -> str:
    """A new token of a play in worker `number`; it cannot be guessed. secret: the server's; now_s:
    Unix time."""
    text = f"{number}-{int(now_s):09x}{secrets.token_urlsafe(16)}"
    return text + _mac(text, secret)


def is_issued(token: str, secret: bytes, now_s: float) -> bool:
    """Whether `make_token` made `token` with this secret, in any worker, within MAX_TOKEN_AGE_S."""
    match = _ISSUED.fullmatch(token)
    if match is None:
        return False
    text, mac = token[:-_MAC_CHARS], token[-_MAC_CHARS:]
    is_ours = hmac.compare_digest(_mac(text, secret), mac)
    return is_ours and now_s < int(match[1], 16) + MAX_TOKEN_AGE_S


def issue_time_s(token: str) -> int:
    """When `make_token` made `token`, which `is_issued`: Unix time."""
    match = _ISSUED.fullmatch(token)
    assert match is not None
    return int(match[1], 16)


def _mac(text: str, secret: bytes) -> str:
    digest = hmac.digest(secret, text.encode(), "sha256")
    return urlsafe_b64encode(digest[:_MAC_BYTES]).decode()


def worker_of(token: str) -> int | None:
    """The worker that made `token`; None where none can have."""
    match = _TOKEN.fullmatch(token)
    return int(match[1]) if match else None
