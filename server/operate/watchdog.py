"""Notifications to systemd (sd_notify): the server is ready, and it is alive.

With one worker the event loop sends the heartbeat, so systemd restarts a server whose loop hangs.
With several the arbiter does: it replaces workers that hang, and systemd watches the arbiter.
"""

from __future__ import annotations

import asyncio
import logging
import os
import socket
import time
from collections.abc import Callable, MutableMapping

log = logging.getLogger(__name__)

PINGS_PER_TIMEOUT = 3

SEND_TIMEOUT_S = 1.0


class Watchdog:
    """Does nothing where no systemd asks for notifications."""

    def __init__(
        self,
        environment: MutableMapping[str, str] = os.environ,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Takes the variables of systemd out of `environment`, so that nothing else uses them."""
        address = environment.pop("NOTIFY_SOCKET", "")
        timeout_us = environment.pop("WATCHDOG_USEC", "")
        pid = environment.pop("WATCHDOG_PID", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._interval_s: float | None = None  # None: no heartbeat is wanted
        if address and timeout_us.isdecimal() and pid in ("", str(os.getpid())):
            self._interval_s = int(timeout_us) / 1e6 / PINGS_PER_TIMEOUT
        self._pinged_s = -float("inf")
        self._clock = clock

    def ready(self) -> None:
        """Reports that the service has started."""
        self._send(b"READY=1")

    def ping(self) -> None:
        """Sends a heartbeat if one is due; may be called as often as wanted."""
        now_s = self._clock()
        if self._interval_s is not None and now_s - self._pinged_s >= self._interval_s:
            self._pinged_s = now_s
            self._send(b"WATCHDOG=1")

    def ping_from_loop(self) -> None:
        """From now on, the running event loop sends the heartbeats."""
        self.ping()
        if self._interval_s is not None:
            # More often than due, because a timer may fire a little early.
            asyncio.get_running_loop().call_later(self._interval_s / 2, self.ping_from_loop)

    def _send(self, message: bytes) -> None:
        if not self._address:
            return
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
                sender.settimeout(SEND_TIMEOUT_S)
                sender.sendto(message, self._address)
        except OSError as error:
            log.warning("systemd was not notified: %s", error)
