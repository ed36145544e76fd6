"""Ports of servers that go away, come back, or were never there.

The system gives ports of one range to whoever asks for any, and to both ends of connections: a port
that a test gives up for a moment may be another test's in the next. Those below are asked for.
"""

from __future__ import annotations

import random
import socket
from pathlib import Path

LOWEST, GIVEN_FROM = 12_000, 32_768
"""The second is Linux's own, where it does not say another one."""

RANGE = Path("/proc/sys/net/ipv4/ip_local_port_range")

_marks: list[socket.socket] = []


def kept_port() -> int:
    """A free port that no other caller, in whatever process, gets while this process lives."""
    given_from = int(RANGE.read_text().split()[0]) if RANGE.exists() else GIVEN_FROM
    draw = random.SystemRandom()  # tests seed the other ones
    while True:
        port = draw.randrange(LOWEST, given_from)
        mark = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)  # no server here listens on it
        try:
            mark.bind(("127.0.0.1", port))
            socket.create_server(("127.0.0.1", port)).close()
        except OSError:
            mark.close()
            continue
        _marks.append(mark)
        return port
