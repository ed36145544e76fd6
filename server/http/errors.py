"""Errors of requests, as answers to their clients."""

from __future__ import annotations

import json
from collections.abc import Mapping

from aiohttp import web


class RequestError(web.HTTPException):
    """An error status, and one line of JSON that says why."""

    def __init__(self, status: int, message: str, headers: Mapping[str, str] | None = None) -> None:
        self.status_code = status
        super().__init__(
            text=json.dumps({"error": message}),
            content_type="application/json",
            headers={"Cache-Control": "no-store", **(headers or {})},
        )
        self.message = message

    def __str__(self) -> str:
        return self.message
