"""Slow clients as a process: `python -m tests.server.hostile.attack KIND PORT COUNT SECONDS PATH`.

KIND is `heads`, which send one byte of their request per second and never finish it; or `readers`,
which request PATH and read nothing of it, or, every second client, 16 bytes per second. They use
many addresses of the loopback, so that a limit per address does not help. Prints "connected" once
all are connected.
"""

from __future__ import annotations

import contextlib
import socket
import sys
import time

HEAD = b"GET /healthz HTTP/1.1\r\nHost: h\r\nX-Slow: "
READ_BYTES = 16


def address(number: int) -> str:
    return f"127.0.{1 + number // 250}.{1 + number % 250}"


def connect(kind: str, port: int, number: int, path: str) -> socket.socket:
    sock = socket.socket()
    if kind == "readers":
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    sock.settimeout(5)
    sock.bind((address(number % 250), 0))
    sock.connect(("127.0.0.1", port))
    request = f"GET {path} HTTP/1.1\r\nHost: h\r\n\r\n".encode()
    sock.sendall(HEAD[:10] if kind == "heads" else request)
    sock.setblocking(False)
    return sock


def attack(kind: str, port: int, count: int, seconds: float, path: str) -> None:
    socks = [connect(kind, port, number, path) for number in range(count)]
    sys.stdout.write("connected\n")
    sys.stdout.flush()
    for step in range(round(seconds)):
        time.sleep(1)  # sleeps: the rate of slow clients
        for number, sock in enumerate(socks):
            # The server's descriptors show that the client was cut.
            with contextlib.suppress(OSError):
                if kind == "heads":
                    sock.send(HEAD[10 + step : 11 + step] or b"y")
                elif number % 2:
                    sock.recv(READ_BYTES)


def main() -> None:
    kind, port, count, seconds, path = sys.argv[1:]
    attack(kind, int(port), int(count), float(seconds), path)


if __name__ == "__main__":
    main()
