"""A socket for each worker, made before they are: everybody may send into it, its owner reads."""

from __future__ import annotations

import socket


class Mailboxes:
    """Datagram sockets for `num_places` workers. Without a name, they are in nobody's way.

    They outlive the workers: who takes the place of one that died reads on from its socket.
    """

    def __init__(self, num_places: int) -> None:
        pairs = [socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM) for _ in range(num_places)]
        for pair in pairs:
            for end in pair:
                end.setblocking(False)
        self.inboxes = tuple(inbox for inbox, _ in pairs)
        """What the worker of a place reads from."""
        self.outboxes = tuple(outbox for _, outbox in pairs)
        """What everybody writes into."""

    def close(self) -> None:
        for end in (*self.inboxes, *self.outboxes):
            end.close()
