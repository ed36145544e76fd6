"""Slow clients as a process: `python -m tests.server.hostile.attack KIND PORT COUNT SECONDS PATH`.

KIND is `heads`, which send a byte of their request a second and never end it; or `readers`, which
ask for PATH and take nothing of it, or, every second one, 16 bytes a second. They come from many
addresses of the loopback, so that no limit on one address helps. Prints a line once all are
connected, and at the end JSON: how many seconds each was kept, and how many were still kept.
"""

from __future__ import annotations

import contextlib
import json
import select
import socket
import sys
import time

HEAD = b"GET /healthz HTTP/1.1\r\nHost: h\r\nX-Slow: "
READ_BYTES = 16
GONE = select.EPOLLRDHUP | select.EPOLLHUP | select.EPOLLERR


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


def attack(kind: str, port: int, count: int, seconds: float, path: str) -> dict[str, object]:
    began_s: dict[int, float] = {}
    socks: dict[int, socket.socket] = {}
    epoll = select.epoll()
    refused = 0
    for number in range(count):
        try:
            sock = connect(kind, port, number, path)
        except OSError:
            refused += 1
            continue
        socks[sock.fileno()] = sock
        began_s[sock.fileno()] = time.monotonic()
        # A reader has bytes waiting all the time: only the end is asked for.
        epoll.register(sock, GONE)
    say("connected")
    kept_s: list[float] = []
    next_s, end_s, step = time.monotonic() + 1, time.monotonic() + seconds, 10
    while socks and time.monotonic() < end_s:
        for number, _ in epoll.poll(0.1):
            socks.pop(number).close()
            kept_s.append(time.monotonic() - began_s[number])
        if time.monotonic() < next_s:
            continue
        next_s += 1
        step += 1
        for number, sock in socks.items():
            # Whoever is gone is found by the poll.
            with contextlib.suppress(OSError):
                if kind == "heads":
                    sock.send(HEAD[step : step + 1] or b"y")
                elif number % 2:
                    sock.recv(READ_BYTES)
    return {"kept_s": kept_s, "left": len(socks), "refused": refused}


def say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def main() -> None:
    kind, port, count, seconds, path = sys.argv[1:]
    say(json.dumps(attack(kind, int(port), int(count), float(seconds), path)))


if __name__ == "__main__":
    main()
