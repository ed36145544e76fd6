"""aiohttp's server, as this one needs it: public API only, and what its parser refuses counted."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Mapping
from typing import Any, Final

from aiohttp import web
from aiohttp.http import HttpProcessingError
from aiohttp.http_exceptions import LineTooLong

from server.exchange.response import error_response

from .connection import LINGER_S, Refused, connection_of

MAX_TARGET_BYTES: Final = 8 * 1024
MAX_FIELD_BYTES: Final = MAX_TARGET_BYTES - 1
"""Of a name and its value. One less, because aiohttp's error tells the two apart by their limit
alone."""
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


def refusal_of(error: HttpProcessingError) -> tuple[int, str]:
    """Status and reason of the answer to what aiohttp could not read."""
    if isinstance(error, LineTooLong):
        if error.args[1] == MAX_TARGET_BYTES:
            return 414, f"the target of the request has more than {MAX_TARGET_BYTES} bytes"
        return 431, f"a field of the head has more than {MAX_FIELD_BYTES} bytes"
    if "Too many headers" in error.message:
        return 431, f"the head has more than {MAX_FIELDS} fields"
    return 400, "the request is not HTTP"


def http_server(
    handler: Callable[[web.BaseRequest], Awaitable[web.StreamResponse]],
    refused: Refused,
    keepalive_timeout_s: float,
    common: Mapping[str, str],
) -> Callable[[], asyncio.Protocol]:
    """Makes the protocols of ClientConnection. handler: answers a request. refused: called for each
    request that is not HTTP. common: fields that every response has."""
    loop = asyncio.get_running_loop()

    def make_request(
        message: Any, payload: Any, protocol: Any, writer: Any, task: Any
    ) -> web.BaseRequest:
        request = web.BaseRequest(message, payload, protocol, writer, task, loop)
        if request.method != NO_METHOD and request.transport is not None:
            connection_of(request).begin(writer)
        return request

    class Speaker(web.RequestHandler):
        """aiohttp's protocol of a connection, whose errors are JSON like all others."""

        def handle_error(
            self,
            request: web.BaseRequest,
            status: int = 500,
            exc: BaseException | None = None,
            message: str | None = None,
        ) -> web.StreamResponse:
            if not isinstance(exc, HttpProcessingError) or request.writer.output_size:
                return super().handle_error(request, status, exc, message)
            status, reason = refusal_of(exc)
            refused(request.remote or "", status, reason)
            error = error_response(status, reason, {})
            headers = {**common, **error.fields}
            answer = web.Response(status=status, body=error.body, headers=headers)
            answer.force_close()
            return answer

    server = web.Server(handler, request_factory=make_request, handler_cancellation=True)
    return lambda: Speaker(
        server,
        loop=loop,
        access_log=None,  # type: ignore[arg-type]
        logger=log,
        # A connection's own limits come first.
        keepalive_timeout=2 * keepalive_timeout_s,
        lingering_time=LINGER_S,
        tcp_keepalive=False,
        max_line_size=MAX_TARGET_BYTES,
        max_field_size=MAX_FIELD_BYTES,
        max_headers=MAX_FIELDS,
        auto_decompress=False,
    )
