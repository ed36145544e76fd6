"""A link as the user writes it: a rate, `8M` (bits per second; k, M, G), a rate and a latency,
`8M,20ms`, or the name of a trace, a file that server/abr/traces.py can read."""

from __future__ import annotations

import re

from codec.errors import InvalidError
from server.abr.link import Link, LinkStep
from server.abr.traces import MAX_TRACE_BYTES, parse_trace

_LINK = re.compile(r"(\d+(?:\.\d+)?)([kMG]?)(?:,(\d+(?:\.\d+)?)ms)?")

_PREFIXES = {"": 1.0, "k": 1e3, "M": 1e6, "G": 1e9}

_ROUND_S = 3600.0
"""Step length of a link that never changes, seconds; any would do."""


def read_link(text: str) -> Link:
    """The link that `text` describes, see above. Raises InvalidError."""
    match = _LINK.fullmatch(text)
    if match:
        rate_bps, latency_s = float(match[1]) * _PREFIXES[match[2]], float(match[3] or 0) / 1000
        return Link([LinkStep(_ROUND_S, rate_bps, latency_s)])
    try:
        with open(text, "rb") as file:
            data = file.read(MAX_TRACE_BYTES + 1)
    except (OSError, ValueError) as error:  # ValueError: no file can have this name
        reason = error.strerror if isinstance(error, OSError) else error
        raise InvalidError(
            f"link {text!r} is neither a rate such as 8M or 8M,20ms nor a trace: {reason}"
        ) from error
    return parse_trace(data, text)
