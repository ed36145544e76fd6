"""Runs the application on a socket until the process is told to stop."""

from __future__ import annotations

import asyncio
import signal
import socket
import ssl
from collections.abc import Callable

from .app import Application
from .errors import ServerError
from .http.acceptor import Acceptor
from .state.serverstate import ServerState

UNSENT_BYTES = 256 * 1024
"""Bytes that the kernel takes of one connection before they can be sent."""

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


def bound_connections(listener: socket.socket, write_timeout_s: float) -> None:
    """Bounds what a peer that takes nothing costs: UNSENT_BYTES in the kernel, for a while only.

    The kernel cuts such a connection after twice the timeout. That covers what nobody here watches
    any more: bytes that are still in buffers when a connection was closed. Accepted connections
    inherit both from `listener`.
    """
    if hasattr(socket, "TCP_NOTSENT_LOWAT"):
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, UNSENT_BYTES)
    if hasattr(socket, "TCP_USER_TIMEOUT"):
        milliseconds = max(1, round(2000 * write_timeout_s))
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, milliseconds)


class RunningServer:
    """The server on one socket, between `start` and `stop`."""

    def __init__(
        self, state: ServerState, listener: socket.socket, tls: ssl.SSLContext | None = None
    ) -> None:
        """tls: None for plain HTTP."""
        self._state = state
        self._listener = listener
        self.app = Application(state)
        self._acceptor = Acceptor(self.app, listener, tls)
        self._watch: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """Begins to serve, what is in the library by then."""
        bound_connections(self._listener, self._state.config.patience.write_timeout_s)
        self._watch = asyncio.create_task(self._state.library.watch())
        self._acceptor.start()

    async def stop(self) -> None:
        """Lets plays end at their next slice and answers what was asked, within
        `shutdown_timeout_s`. Stopping twice is the same as once."""
        if self._watch is None:
            return
        watch, self._watch = self._watch, None
        self._state.stopping.set()
        await self._acceptor.stop(self._state.config.shutdown_timeout_s)
        self._listener.close()
        watch.cancel()
        await asyncio.wait([watch])


async def run_until_stopped(server: RunningServer, ready: Callable[[], None]) -> None:
    """Serves, calls `ready` once, and ends gracefully on SIGTERM or SIGINT.

    A second signal ends the process at once.
    """
    loop = asyncio.get_running_loop()
    stop = asyncio.Event()
    signals = (signal.SIGTERM, signal.SIGINT)
    for number in signals:
        loop.add_signal_handler(number, stop.set)
    await server.start()
    try:
        ready()
        await stop.wait()
    finally:
        for number in signals:
            loop.remove_signal_handler(number)
        await server.stop()
