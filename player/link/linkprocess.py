"""The relay in a process of its own, so that nothing the player does can delay it."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import subprocess
import sys
import threading
from types import TracebackType
from typing import Any

from codec.errors import SwingsError
from server.abr.link import Link

log = logging.getLogger(__name__)

CLOSE_S = 5.0
"""Seconds that the process gets to end by itself."""


class RelayError(SwingsError):
    """The process of the link cannot start, or has died."""


class LinkProcess:
    """Passes every connection to `address` on to (host, port), as `link` says.

    Use it with `with`, or close it. A block that ends with an error raises RelayError if the
    process has died. It ends with this process, however that ends: it watches a pipe.
    """

    def __init__(self, link: Link, host: str, port: int) -> None:
        """Raises RelayError."""
        self._lock = threading.Lock()
        self._closed = False
        steps = [(step.duration_s, step.rate_bps, step.latency_s) for step in link.steps]
        order = {"host": host, "port": port, "steps": steps}
        places = [place or os.getcwd() for place in sys.path]
        try:
            self._process = subprocess.Popen(
                # -P: the current folder may hold another `player`.
                [sys.executable, "-P", "-m", "player.link"],
                env={**os.environ, "PYTHONPATH": os.pathsep.join(places)},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=None if log.isEnabledFor(logging.DEBUG) else subprocess.DEVNULL,
                text=True,
                start_new_session=True,  # Ctrl-C is for the player; it says when to end
            )
        except OSError as error:
            raise RelayError(f"the emulated link cannot start: {error}") from error
        try:
            self.address: tuple[str, int] = ("127.0.0.1", self._ask(order)["port"])
            """Where to connect instead of to the server."""
        except BaseException:
            self.close()
            raise

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def down_bytes(self) -> int:
        """Bytes passed from the server to the player. Raises RelayError."""
        found: int = self._ask({})["down_bytes"]
        return found

    @property
    def began_s(self) -> float | None:
        """When the first connection came, which is the link's time 0, by time.monotonic; None
        before. Raises RelayError."""
        found: float | None = self._ask({})["began_s"]
        return found

    def _ask(self, question: dict[str, Any]) -> dict[str, Any]:
        """Sends a line and gives the answer."""
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            with self._lock:
                process.stdin.write(json.dumps(question) + "\n")
                process.stdin.flush()
                line = process.stdout.readline()
            answer: dict[str, Any] = json.loads(line)
        except (OSError, ValueError) as error:  # its end of the pipe has gone
            raise self._dead() from error
        if "error" in answer:
            raise RelayError(f"the emulated link cannot listen: {answer['error']}")
        return answer

    def _dead(self) -> RelayError:
        status = self._process.wait()
        how = f"signal {-status}" if status < 0 else f"exit code {status}"
        return RelayError(f"the process of the emulated link ended ({how}); play again")

    def close(self) -> None:
        """Cuts all connections and ends the process; closing twice is the same as once."""
        process, self._closed = self._process, True
        assert process.stdin is not None
        assert process.stdout is not None
        with contextlib.suppress(OSError):  # what was not written yet has no reader
            process.stdin.close()
        try:
            process.wait(CLOSE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        process.stdout.close()

    def __enter__(self) -> LinkProcess:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            # What broke may have broken because the process has gone.
            if isinstance(error, SwingsError | OSError) and not self._closed:
                self._ask({})
        except RelayError as dead:
            raise dead from error
        finally:
            self.close()
