"""Notifications to systemd (sd_notify): the server is ready, and it is alive.

Event loops send the heartbeats, of one process or of each worker: systemd restarts a server none of
whose loops runs.
"""

from __future__ import annotations

import asyncio
import logging
import os
import socket
from collections.abc import MutableMapping

log = logging.getLogger(__name__)

PINGS_PER_TIMEOUT = 3

SEND_TIMEOUT_S = 1.0


class Watchdog:
    """Does nothing where no systemd asks for notifications."""

    def __init__(self, environment: MutableMapping[str, str] = os.environ) -> None:
        """Takes the variables of systemd out of `environment`, so that nothing else uses them."""
        address = environment.pop("NOTIFY_SOCKET", "")
        timeout_us = environment.pop("WATCHDOG_USEC", "")
        pid = environment.pop("WATCHDOG_PID", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._interval_s: float | None = None  # None: no heartbeat is wanted
        if address and timeout_us.isdecimal() and pid in ("", str(os.getpid())):
            self._interval_s = int(timeout_us) / 1e6 / PINGS_PER_TIMEOUT

    def ready(self) -> None:
        """Reports that the service has started; from now on the running event loop sends
        heartbeats."""
        self._send(b"READY=1")
        self._ping()

    def _ping(self) -> None:
        if self._interval_s is not None:
            self._send(b"WATCHDOG=1")
            asyncio.get_running_loop().call_later(self._interval_s, self._ping)

    def _send(self, message: bytes) -> None:
        if not self._address:
            return
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
                sender.settimeout(SEND_TIMEOUT_S)
                sender.sendto(message, self._address)
        except OSError as error:
            log.warning("systemd was not notified: %s", error)
