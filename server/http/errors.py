"""Errors by who must act: the client of a request, or the operator of the server."""

from __future__ import annotations

import json
from collections.abc import Mapping

from aiohttp import web

from codec.errors import SwingsError


class RequestError(web.HTTPException):
    """An error status, and one line of JSON that says why."""

    def __init__(self, status: int, message: str, headers: Mapping[str, str] | None = None) -> None:
        self.status_code = status
        super().__init__(
            text=json.dumps({"error": message}),
            content_type="application/json",
            headers={"Cache-Control": "no-store", **(headers or {})},
        )
        self.args = (message,)  # what str() gives


class ServerError(SwingsError):
    """The server cannot start, or go on, with what it was given."""
