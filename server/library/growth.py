"""Waiting for a live stream to grow.

Rule: the stream is polled only while a task waits, and by one poller however many tasks wait.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

LIVE_POLL_S = 0.05
"""Seconds between two looks at a stream while a task waits for its growth."""


class Growth:
    """Belongs to one stream; lives on an event loop."""

    def __init__(self, look: Callable[[], Awaitable[None]], poll_s: float = LIVE_POLL_S) -> None:
        """look: looks at the stream, and calls `wake` if it has changed."""
        self._look = look
        self._poll_s = poll_s
        self._woken = asyncio.Event()
        self._poller: asyncio.Task[None] | None = None
        self.num_waiting = 0

    def wake(self) -> None:
        """Lets all waiting tasks check their conditions."""
        self._woken.set()
        self._woken = asyncio.Event()

    async def wait(self, is_over: Callable[[], bool], timeout_s: float) -> None:
        """Returns when `is_over`, or after `timeout_s`."""
        if not self.num_waiting:
            self._woken = asyncio.Event()  # one belongs to the loop on which it was waited for
            self._poller = asyncio.create_task(self._poll())
        self.num_waiting += 1
        try:
            async with asyncio.timeout(timeout_s):
                while not is_over():
                    await self._woken.wait()
        except TimeoutError:
            pass
        finally:
            self.num_waiting -= 1
            if not self.num_waiting and self._poller is not None:
                self._poller.cancel()
                self._poller = None

    async def _poll(self) -> None:
        while True:
            await self._look()
            await asyncio.sleep(self._poll_s)
