"""Runs the application on a socket until the process is told to stop."""

from __future__ import annotations

import asyncio
import logging
import signal
import socket
from collections.abc import Callable

from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError

from .client.connection import bound_connections
from .config import ServerConfig
from .errors import ServerError

BACKLOG = 1024
"""Connections that the kernel may hold until the event loop accepts them."""


def bind(host: str, port: int) -> socket.socket:
    """A bound TCP socket. Raises ServerError that says what to change."""
    if not 0 <= port <= 65535:
        raise ServerError(f"port {port} is not in 0..65535")
    try:
        family, _, _, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
    except (socket.gaierror, UnicodeError) as error:
        raise ServerError(f"no address is known for host {host!r}") from error
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(address)
        # Two servers may bind one port until one of them listens.
        listener.listen(BACKLOG)
    except OSError as error:
        listener.close()
        raise ServerError(
            f"cannot listen on {host} port {port}: {error.strerror}; "
            f"choose another --port, or 0 for any free one"
        ) from error
    return listener


def url_of(listener: socket.socket) -> str:
    """http://HOST:PORT of a bound socket."""
    host, port = listener.getsockname()[:2]
    return (
        f"http://[{host}]:{port}" if listener.family == socket.AF_INET6 else f"http://{host}:{port}"
    )


def make_runner(app: web.Application, config: ServerConfig) -> web.AppRunner:
    """aiohttp's part of the server, with our limits; `cleanup` ends it gracefully."""
    return web.AppRunner(
        app,
        access_log=None,
        logger=_quiet_logger(),
        keepalive_timeout=config.keepalive_timeout_s,
        shutdown_timeout=config.shutdown_timeout_s,
    )


async def run_until_stopped(
    app: web.Application,
    listener: socket.socket,
    config: ServerConfig,
    ready: Callable[[], None],
) -> None:
    """Serves on `listener`, calls `ready` once, and ends gracefully on SIGTERM or SIGINT.

    A second signal ends the process at once.
    """
    loop = asyncio.get_running_loop()
    stop = asyncio.Event()
    signals = (signal.SIGTERM, signal.SIGINT)
    for number in signals:
        loop.add_signal_handler(number, stop.set)
    bound_connections(listener, config.write_timeout_s)
    runner = make_runner(app, config)
    await runner.setup()
    try:
        await web.SockSite(runner, listener, backlog=BACKLOG).start()
        ready()
        await stop.wait()
    finally:
        for number in signals:
            loop.remove_signal_handler(number)
        await runner.cleanup()


def _quiet_logger() -> logging.Logger:
    """aiohttp's log without the tracebacks of requests that are not HTTP."""
    logger = logging.getLogger("server.http")
    logger.addFilter(_is_our_fault)
    return logger


def _is_our_fault(record: logging.LogRecord) -> bool:
    error = record.exc_info[1] if record.exc_info else None
    return not isinstance(error, HttpProcessingError | web.RequestPayloadError)
