"""Questions from one worker to another, such as a status report for a play that runs there.

Rule: no question waits for long for a worker that does not answer. The kernel bounds what waits for
a worker, some hundred messages; the rest is dropped and counted, and has no answer.
"""

from __future__ import annotations

import asyncio
import logging
import secrets
import socket
import struct
from collections.abc import Callable
from dataclasses import dataclass

from codec.errors import InvalidError

log = logging.getLogger(__name__)

TIMEOUT_S = 1.0
"""Seconds that an answer may take."""

MAX_MESSAGE_BYTES = 4096

READ_AT_ONCE = 64
"""Messages that are taken in before others on the event loop have their turn."""

_HEAD = struct.Struct("<BHQ")
"""Kind, sender, number of the question."""

_REQUEST, _REPLY = 1, 2


class Mailboxes:
    """A datagram socket for each of `num_places` workers: all send into it, its owner reads.

    They have no name, so only the workers reach them. They outlive the workers: the successor of
    a worker that died reads on from its socket.
    """

    def __init__(self, num_places: int) -> None:
        pairs = [socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM) for _ in range(num_places)]
        self.inboxes, self.outboxes = zip(*pairs, strict=True)
        for end in (*self.inboxes, *self.outboxes):
            end.setblocking(False)

    def close(self) -> None:
        for end in (*self.inboxes, *self.outboxes):
            end.close()


@dataclass(slots=True)
class PeerCounts:
    """Counts of messages by outcome, for the metrics."""

    asked: int = 0
    answered: int = 0
    unanswered: int = 0
    """Questions that timed out, or that could not be sent."""
    dropped: int = 0
    """Messages for which there was no room."""
    refused: int = 0
    """Answers that came too late."""


class Peers:
    """One worker's side. It must be used on one event loop, and be closed on it."""

    def __init__(self, number: int, mailboxes: Mailboxes, timeout_s: float = TIMEOUT_S) -> None:
        """number: of this worker. mailboxes: those of all."""
        self._number = number
        self._mailboxes = mailboxes
        self._timeout_s = timeout_s
        self._waiting: dict[int, asyncio.Future[bytes]] = {}
        # Not from 0: answers to a predecessor, which died, must not be taken for ours.
        self._next = secrets.randbits(62)
        self.counts = PeerCounts()
        self.on_request: Callable[[bytes], bytes] = lambda _: b""
        """Answers the questions of others, at once. Its answer is MAX_MESSAGE_BYTES at most."""

    def start(self) -> None:
        """Begins to take messages in; must be called on the event loop."""
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(self._mailboxes.inboxes[self._number], self._read)

    def close(self) -> None:
        """Takes no more messages in; questions that wait end without an answer."""
        self._loop.remove_reader(self._mailboxes.inboxes[self._number])
        for future in self._waiting.values():
            future.cancel()

    async def ask(self, number: int, message: bytes) -> bytes | None:
        """The answer of worker `number`; None if it does not answer or does not exist.

        Raises InvalidError for a message of more than MAX_MESSAGE_BYTES.
        """
        if len(message) > MAX_MESSAGE_BYTES:
            raise InvalidError(f"a message of {len(message)} bytes; at most {MAX_MESSAGE_BYTES}")
        self.counts.asked += 1
        if not 0 <= number < len(self._mailboxes.outboxes):
            self.counts.unanswered += 1
            return None
        question = self._next
        self._next += 1
        future: asyncio.Future[bytes] = self._loop.create_future()
        self._waiting[question] = future
        try:
            if self._send(number, _HEAD.pack(_REQUEST, self._number, question) + message):
                await asyncio.wait((future,), timeout=self._timeout_s)
        finally:
            del self._waiting[question]
        # An answer that came while this worker itself was late is an answer.
        if future.done() and not future.cancelled():
            self.counts.answered += 1
            return future.result()
        self.counts.unanswered += 1
        return None

    def _read(self) -> None:
        for _ in range(READ_AT_ONCE):
            try:
                data = self._mailboxes.inboxes[self._number].recv(_HEAD.size + MAX_MESSAGE_BYTES)
            except (BlockingIOError, InterruptedError):
                return
            kind, sender, question = _HEAD.unpack_from(data)
            if kind == _REQUEST:
                self._answer(sender, question, data[_HEAD.size :])
            elif (future := self._waiting.get(question)) and not future.done():
                future.set_result(data[_HEAD.size :])
            else:
                self.counts.refused += 1

    def _answer(self, asker: int, question: int, message: bytes) -> None:
        try:
            answer = self.on_request(message)
        except Exception:
            log.exception("answering a request from another worker failed")
            return
        assert len(answer) <= MAX_MESSAGE_BYTES
        self._send(asker, _HEAD.pack(_REPLY, self._number, question) + answer)

    def _send(self, number: int, data: bytes) -> bool:
        """Sends now; False where too much waits already, or the server stops."""
        try:
            self._mailboxes.outboxes[number].send(data)
        except OSError:
            self.counts.dropped += 1
            return False
        return True
