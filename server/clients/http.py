"""aiohttp's server, as this one needs it: public API only, and what its parser refuses counted."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable
from typing import Any, Final

from aiohttp import web
from aiohttp.http import HttpProcessingError

from .connection import LINGER_S, Refused, connection_of

MAX_LINE_BYTES: Final = 8 * 1024
MAX_FIELDS: Final = 100

NO_METHOD: Final = "UNKNOWN"
"""The method of what aiohttp could not read; no request has it."""

log = logging.getLogger(__name__)


def is_our_fault(record: logging.LogRecord) -> bool:
    """Whether a record of aiohttp's is about this server, and not about a client: a request that is
    not HTTP gets one line of the log, like every other."""
    error = record.exc_info[1] if record.exc_info else None
    return not isinstance(error, HttpProcessingError | ConnectionError)


log.addFilter(is_our_fault)


def http_server(
    handler: Callable[[web.BaseRequest], Awaitable[web.StreamResponse]],
    refused: Refused,
    keepalive_timeout_s: float,
) -> web.Server:
    """Makes the protocols of ClientConnection. handler: answers a request. refused: called for each
    request that is not HTTP."""
    loop = asyncio.get_running_loop()

    def make_request(
        message: Any, payload: Any, protocol: Any, writer: Any, task: Any
    ) -> web.BaseRequest:
        request = web.BaseRequest(message, payload, protocol, writer, task, loop)
        if request.method == NO_METHOD:  # aiohttp answers it with 400
            refused(request.remote or "", 400, "the request is not HTTP")
        elif request.transport is not None:
            connection_of(request).begin(writer)
        return request

    return web.Server(
        handler,
        request_factory=make_request,
        handler_cancellation=True,
        access_log=None,
        logger=log,
        # A connection's own limits come first.
        keepalive_timeout=2 * keepalive_timeout_s,
        lingering_time=LINGER_S,
        tcp_keepalive=False,
        max_line_size=MAX_LINE_BYTES,
        max_field_size=MAX_LINE_BYTES,
        max_headers=MAX_FIELDS,
        auto_decompress=False,
    )
