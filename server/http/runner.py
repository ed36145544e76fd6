"""aiohttp's runner with a gate: connections above the limits are refused, and the others get the
time that their responses take to arrive."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final

from aiohttp import web
from aiohttp.abc import AbstractAccessLogger, AbstractStreamWriter
from aiohttp.http import HttpProcessingError

from .connection import MAX_FIELD_BYTES, MAX_FIELDS, MAX_TARGET_BYTES, Clients, Connection

LINGER_S: Final = 2.0
"""Seconds for the rest of a request whose answer did not need it."""

LAST_CALL_S: Final = 0.5
"""Seconds for the first request of a client that was accepted just before the server stopped."""

LOOK_S: Final = 0.01
"""How often it is looked whether a stopping server has done its work, seconds."""

log = logging.getLogger(__name__)


def is_our_fault(record: logging.LogRecord) -> bool:
    """Whether a record of aiohttp's is about this server, and not about a client."""
    error = record.exc_info[1] if record.exc_info else None
    return not isinstance(error, HttpProcessingError | ConnectionError | web.RequestPayloadError)


log.addFilter(is_our_fault)


class Gate(web.Server):
    """The server of an application, with a Connection for each client."""

    def __init__(self, inner: web.Server, clients: Clients, options: dict[str, Any]) -> None:
        """inner: of the application. options: of web.RequestHandler."""
        make = inner.request_factory

        def make_request(
            message: Any,
            payload: Any,
            protocol: web.RequestHandler,
            writer: AbstractStreamWriter,
            task: asyncio.Task[None],
        ) -> web.BaseRequest:
            assert isinstance(protocol, Connection)
            protocol.was_asked = True
            return make(message, payload, protocol, writer, task)

        super().__init__(inner.request_handler, request_factory=make_request)
        self._clients = clients
        self._options = options

    def __call__(self) -> Connection:
        return Connection(self._clients, self, self._options)


class Runner(web.AppRunner):
    """Runs an application; also for aiohttp's worker of gunicorn, which takes an AppRunner."""

    def __init__(
        self,
        app: web.Application,
        clients: Clients,
        access_log_class: type[AbstractAccessLogger],
        keepalive_timeout_s: float,
        stop_s: float,
    ) -> None:
        """keepalive_timeout_s: for a whole request, from the connection or the response before it
        on. stop_s: for all responses when the server stops."""
        super().__init__(app)
        self._clients = clients
        self._stop_s = stop_s
        self._gate: Gate | None = None
        self._options = {
            "access_log": log,
            "access_log_class": access_log_class,
            "logger": log,
            "keepalive_timeout": keepalive_timeout_s,
            "lingering_time": LINGER_S,
            "tcp_keepalive": False,
            "max_line_size": MAX_TARGET_BYTES,
            "max_field_size": MAX_FIELD_BYTES,
            "max_headers": MAX_FIELDS,
            "auto_decompress": False,
        }

    @property
    def server(self) -> web.Server | None:
        """What makes the protocols of new connections."""
        return self._gate

    async def setup(self) -> None:
        await super().setup()
        inner = super().server
        assert inner is not None
        self._gate = Gate(inner, self._clients, self._options)

    async def shutdown(self) -> None:
        """Has plays end, and waits until all that was asked is answered and has arrived."""
        await super().shutdown()
        gate = self._gate
        assert gate is not None
        transports = [one.transport for one in gate.connections]
        with suppress(TimeoutError):
            async with asyncio.timeout(self._stop_s):
                with suppress(TimeoutError):
                    async with asyncio.timeout(LAST_CALL_S):
                        await _until(lambda: all(one.was_asked for one in connections(gate)))
                await gate.shutdown(self._stop_s)
                await _until(lambda: not self._clients.admission.num_held)
        await gate.shutdown(LOOK_S)  # who did not take it in time
        for transport in transports:
            if transport is not None:
                transport.abort()
        await asyncio.sleep(0)  # for the ends of these


def connections(server: web.Server | None) -> list[Connection]:
    """The open connections of a Gate."""
    held = server.connections if server is not None else []
    return [one for one in held if isinstance(one, Connection)]


async def _until(done: Callable[[], bool]) -> None:
    while not done():  # noqa: ASYNC110
        await asyncio.sleep(LOOK_S)
