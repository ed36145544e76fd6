"""Questions from one worker to another, such as news of a play that runs there.

Rule: nobody waits for a worker that does not answer. Messages are bounded, and so is what waits to
be sent; what is too much is dropped and counted, and the question ends without an answer.
"""

from __future__ import annotations

import asyncio
import logging
import secrets
import struct
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from codec.errors import InvalidError

from .mailboxes import Mailboxes

log = logging.getLogger(__name__)

TIMEOUT_S = 1.0
"""Seconds that an answer may take."""

MAX_MESSAGE_BYTES = 4096

MAX_WAITING = 256
"""Messages to one worker that wait until its socket has room: the kernel keeps few."""

RETRY_S = 0.002
"""Seconds until a socket that was full is tried again."""

READ_AT_ONCE = 64
"""Messages that are taken in before others on the event loop have their turn."""

_HEAD = struct.Struct("<BHQ")
"""Kind, who asks, number of the question."""

_REQUEST, _REPLY = 1, 2


@dataclass(slots=True)
class PeerCounts:
    """What became of messages, for the figures of the server."""

    asked: int = 0
    answered: int = 0
    unanswered: int = 0
    """Questions that timed out, or that could not be sent."""
    dropped: int = 0
    """Messages for which there was no room."""
    refused: int = 0
    """Messages that made no sense, or came too late."""


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
        self._unsent: dict[int, deque[tuple[float, bytes]]] = {}  # with when it is too late
        self._retry: asyncio.TimerHandle | None = None
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
        if self._retry is not None:
            self._retry.cancel()
        for future in self._waiting.values():
            future.cancel()

    async def ask(self, number: int, message: bytes) -> bytes | None:
        """What worker `number` answers; None where it does not, or there is none of this number.

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
                data = self._mailboxes.inboxes[self._number].recv(
                    _HEAD.size + MAX_MESSAGE_BYTES + 1
                )
            except (BlockingIOError, InterruptedError):
                return
            self._take(data)

    def _take(self, data: bytes) -> None:
        if not _HEAD.size <= len(data) <= _HEAD.size + MAX_MESSAGE_BYTES:
            self.counts.refused += 1
            return
        kind, asker, question = _HEAD.unpack_from(data)
        message = data[_HEAD.size :]
        if kind == _REQUEST and asker < len(self._mailboxes.outboxes):
            try:
                answer = self.on_request(message)
            except Exception:
                log.exception("answering a request from another worker failed")
                return
            assert len(answer) <= MAX_MESSAGE_BYTES
            self._send(asker, _HEAD.pack(_REPLY, self._number, question) + answer)
            return
        future = self._waiting.get(question) if kind == _REPLY else None
        if future is None or future.done():
            self.counts.refused += 1
        else:
            future.set_result(message)

    def _send(self, number: int, data: bytes) -> bool:
        """Sends now or soon; False where too much waits already."""
        unsent = self._unsent.get(number)
        if unsent is None and self._send_now(number, data):
            return True
        if unsent is None:
            unsent = self._unsent[number] = deque()
        if len(unsent) >= MAX_WAITING:
            self.counts.dropped += 1
            return False
        unsent.append((self._loop.time() + self._timeout_s, data))
        if self._retry is None:
            self._retry = self._loop.call_later(RETRY_S, self._send_unsent)
        return True

    def _send_now(self, number: int, data: bytes) -> bool:
        try:
            self._mailboxes.outboxes[number].send(data)
        except (BlockingIOError, InterruptedError):
            return False
        except OSError:
            self.counts.dropped += 1  # it is not there any more: the server stops
        return True

    def _send_unsent(self) -> None:
        self._retry = None
        now_s = self._loop.time()
        for number, unsent in list(self._unsent.items()):
            while unsent and (unsent[0][0] <= now_s or self._send_now(number, unsent[0][1])):
                # Where nobody reads, nobody waits for an answer any more.
                self.counts.dropped += unsent.popleft()[0] <= now_s
            if not unsent:
                del self._unsent[number]
        if self._unsent:
            self._retry = self._loop.call_later(RETRY_S, self._send_unsent)
