"""Names and passwords in URLs: they are for the host alone, never for messages, logs or reports."""

from __future__ import annotations

import re

_USER_INFO = re.compile(r"(?<=://)[^/?#\s]*@")


def without_credentials(text: str) -> str:
    """`text` with names and passwords left out of every URL in it: `http://user:password@host/`
    becomes `http://host/`."""
    return _USER_INFO.sub("", text)
