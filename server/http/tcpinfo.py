"""The kernel's figures of a TCP connection.

Rule: nothing here is needed. A figure that the kernel does not report is None, or 0 bytes, and
callers must cope."""

from __future__ import annotations

import socket
import struct
import sys
from dataclasses import dataclass
from typing import Any, Final

if sys.platform != "win32":
    import fcntl
    import termios

TCP_INFO_BYTES: Final = 168
"""How much of Linux's struct tcp_info is asked for: up to and with tcpi_delivery_rate."""

NOTHING_KNOWN_US: Final = 0xFFFFFFFF
"""Value of tcpi_min_rtt before the first sample, microseconds."""

SO_NWRITE: Final = 0x1024
"""macOS, sys/socket.h: bytes in the send buffer, which keeps them until they are acknowledged."""


@dataclass(frozen=True, slots=True)
class TcpInfo:
    """A connection's figures, of the kernel's own making."""

    min_rtt_s: float | None = None
    """The least round trip of late."""
    delivery_rate_bps: float | None = None
    """The newest sample of how fast bytes arrive."""


def parse_tcp_info(data: bytes) -> TcpInfo:
    """The figures in a struct tcp_info (linux/tcp.h). It has grown with the kernels, at its end: a
    shorter one lacks some."""

    def field(kind: str, offset: int) -> int | None:
        if offset + struct.calcsize(kind) > len(data):
            return None
        number: int = struct.unpack_from(kind, data, offset)[0]
        return number

    rtt_us = field("=I", 148)
    bytes_per_s = field("=Q", 160)
    return TcpInfo(
        min_rtt_s=None if rtt_us in (None, NOTHING_KNOWN_US) else rtt_us / 1e6,
        # 0 until there is a sample.
        delivery_rate_bps=8.0 * bytes_per_s if bytes_per_s else None,
    )


def read_tcp_info(sock: Any) -> TcpInfo | None:
    """The figures of `sock`, a socket or asyncio's stand-in for one; None where there are none."""
    if sys.platform != "linux":
        return None
    try:
        return parse_tcp_info(sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, TCP_INFO_BYTES))
    except OSError:  # it was closed meanwhile, or is not TCP
        return None


def unacked_bytes(sock: Any, platform: str = sys.platform) -> int:
    """Bytes that `sock` holds until they are acknowledged. 0 for a closed socket, and on kernels
    that do not report it: there, bytes that have left the process count as acknowledged.

    Linux's ioctl counts exactly those. tcpi_bytes_acked says no more, and counts the heads of HTTP
    chunks, which the session does not know; so it is not what a play goes by.
    """
    number = 0
    try:
        if platform == "linux":
            packed = fcntl.ioctl(sock.fileno(), termios.TIOCOUTQ, bytes(4))
            (number,) = struct.unpack("=i", packed)
        elif platform == "darwin":
            number = sock.getsockopt(socket.SOL_SOCKET, SO_NWRITE)
    except (OSError, ValueError):  # it was closed meanwhile
        return 0
    return number
