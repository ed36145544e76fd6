"""A server that pours bytes."""

from __future__ import annotations

import select
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager


class Pouring:
    """Sends zeros on each connection: `num_bytes`, or until the connection ends."""

    def __init__(self, num_bytes: int | None) -> None:
        self._num_bytes = num_bytes
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 64 << 10)
        self.port: int = self._listener.getsockname()[1]
        self.sent_bytes = 0
        self.held = threading.Event()
        """Whether the other side has ever taken nothing for a while."""
        self._threads = [threading.Thread(target=self._accept)]
        self._threads[0].start()

    def _accept(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            self._threads.append(threading.Thread(target=self._pour, args=(connection,)))
            self._threads[-1].start()

    def _pour(self, connection: socket.socket) -> None:
        with connection:
            left = self._num_bytes
            try:
                while left is None or left > 0:
                    if not select.select([], [connection], [], 0.5)[1]:
                        self.held.set()
                    sent = connection.send(bytes(16384 if left is None else min(left, 16384)))
                    self.sent_bytes += sent
                    left = None if left is None else left - sent
            except OSError:
                return

    def close(self) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        for thread in self._threads:
            thread.join()


@contextmanager
def pouring(num_bytes: int | None) -> Iterator[Pouring]:
    server = Pouring(num_bytes)
    try:
        yield server
    finally:
        server.close()


def drain(address: tuple[str, int]) -> int:
    with socket.create_connection(address, timeout=120) as connection:
        total = 0
        while piece := connection.recv(65536):
            total += len(piece)
        return total
