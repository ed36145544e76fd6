"""Errors of an object store, described in one line that says what to do."""

from __future__ import annotations

import re

from .credentials import without_credentials

MAX_REASON_CHARS = 200

_METADATA = re.compile(r"http://169\.254\.169\.254/|/latest/(?:api/token|meta-data)")
"""Requests to the service from which machines of a cloud get credentials: obstore asks it if the
environment has none."""

_ANSWER = re.compile("<Code>(.*?)</Code>.*?<Message>(.*?)</Message>", re.DOTALL)
"""The error document of an S3 server."""

_DEBUG = "Debug source"
"""Marks the part of a text that is for the developers of obstore; it ends there."""

_ATTEMPTS = re.compile(r"in ([0-9.]+)(m?s), after ([0-9]+) retries")
"""The time that all attempts of a request took together, and the number of retries."""

_STATUS = re.compile(r"non-2xx status code: ([0-9]{3}[^:\n]*)")

_CAUSE = re.compile(r'(?:message|error): "([^"\n]+)"')
"""The operating system's reason for a failed connection, in the debug text."""

_PLAIN_ENDPOINT = re.compile(r"\bhttp://")


def describe(error: Exception) -> str:
    """The reason that the store or obstore gives for `error`, in one line."""
    text, _, debug = str(error).partition(_DEBUG)
    if advice := _advice(text):
        return advice
    reason = _reason(text, debug)
    line = text if reason is None else _attempts(text) + reason
    return without_credentials(" ".join(line.split()))[:MAX_REASON_CHARS]


def lacks_credentials(error: Exception) -> bool:
    """Whether no credentials were found, neither in the environment nor by the cloud's service."""
    return _METADATA.search(str(error).partition(_DEBUG)[0]) is not None


def _attempts(text: str) -> str:
    """How often and how long the request was tried; empty if only once."""
    found = _ATTEMPTS.search(text)
    if found is None:
        return ""
    return f"{int(found[3]) + 1} attempts in {float(found[1]):.0f} {found[2]} failed: "


def _reason(text: str, debug: str) -> str | None:
    """The store's own reason, or that of the operating system; None if neither is known."""
    if answer := _ANSWER.search(text + debug):
        return ": ".join(answer.groups())
    if status := _STATUS.search(text):
        return f"HTTP {status[1]}"
    if "kind: Timeout," in debug:
        return "no response in time"
    if "IncompleteMessage" in debug:
        return "connection closed without a response"
    causes = _CAUSE.findall(debug)
    return str(causes[-1]) if causes else None  # the last is the innermost


def _advice(text: str) -> str:
    """The setting to change where obstore's own words name a symptom; empty for another error."""
    if _METADATA.search(text):
        return (
            "no credentials: set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or "
            "AWS_SKIP_SIGNATURE=true for a public bucket"
        )
    if "builder error" in text and _PLAIN_ENDPOINT.search(text):
        return (
            "the endpoint is http://, without encryption, which AWS_ALLOW_HTTP forbids; set it to "
            "true, or use an https:// endpoint"
        )
    return ""
