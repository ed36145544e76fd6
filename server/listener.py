"""The socket that a server listens on."""

from __future__ import annotations

import os
import socket
from ipaddress import ip_address

from .http.errors import ServerError
from .state.config import ServerConfig

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
        raise ServerError(f"host {host!r} has no known address; check --host") from error
    is_ipv6 = family == socket.AF_INET6
    try:
        # It listens, as two servers may bind one port until one of them does.
        return socket.create_server(
            address,
            family=family,
            backlog=BACKLOG,
            dualstack_ipv6=is_ipv6 and socket.has_dualstack_ipv6(),
        )
    except OSError as error:
        raise ServerError(
            f"cannot listen on {host} port {port}: {os.strerror(error.errno or 0)}; "
            f"choose another --port, or 0 for any free port"
        ) from error


def url_of(listener: socket.socket, scheme: str = "http") -> str:
    """SCHEME://HOST:PORT of a bound socket."""
    host, port = listener.getsockname()[:2]
    shown = f"[{host}]" if listener.family == socket.AF_INET6 else host
    return f"{scheme}://{shown}:{port}"


def check_public(listener: socket.socket, config: ServerConfig) -> None:
    """Raises ServerError if other machines could reach the streams without a key, and the operator
    did not allow that."""
    host = listener.getsockname()[0].partition("%")[0]
    if config.keys is None and not config.public and not ip_address(host).is_loopback:
        raise ServerError(
            "other machines could access all streams; give --public to allow this, "
            "or --keys FILE to require signed URLs (swings-sign)"
        )


def bound_connections(listener: socket.socket, write_timeout_s: float) -> None:
    """Bounds what a peer that takes nothing costs in the kernel: UNSENT_BYTES, for
    `write_timeout_s`; and has what is written go out at once. Accepted connections inherit all
    three from `listener`."""
    # Else the last, small piece of a response waits until the client has acknowledged the others.
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    if hasattr(socket, "TCP_NOTSENT_LOWAT"):
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, UNSENT_BYTES)
    if hasattr(socket, "TCP_USER_TIMEOUT"):
        milliseconds = max(1, round(1000 * write_timeout_s))
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, milliseconds)
