"""A real bottleneck: two network namespaces with a token bucket (tbf) between them. Needs root."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from server.abr.link import Link, LinkStep

LEAST_BPS = 8e3
"""Minimum rate of the link, because tbf needs one; negligible here."""

BURST_S = 0.004
LEAST_BURST_BYTES = 3200
"""Two whole packets: a packet larger than the bucket never passes."""

QUEUE_S = 0.1
LEAST_QUEUE_BYTES = 16_000
"""The queue holds QUEUE_S at the fastest rate, at least this; a router, too, drops the rest."""

TCP_SHARE = 1448 / 1514
"""Share of TCP payload in a full Ethernet frame: tbf counts the headers, too."""


def addresses() -> tuple[str, str]:
    """Addresses of this end and of the end behind the link; other processes have different ones."""
    number = os.getpid() % (1 << 14)
    network = f"10.213.{number >> 6}"
    first = 4 * (number & 63)
    return f"{network}.{first + 1}", f"{network}.{first + 2}"


def why_not() -> str | None:
    """The reason why this machine cannot have such a link; None if it can."""
    if sys.platform != "linux":
        return "network namespaces are Linux's"
    if os.geteuid() != 0:
        return "network namespaces need root"
    missing = [tool for tool in ("ip", "tc") if shutil.which(tool) is None]
    if missing:
        return f"{' and '.join(missing)} (iproute2) not found"
    try:
        with shaped_link(Link([LinkStep(1.0, 1e6, 0.0)])):
            return None
    except subprocess.CalledProcessError as error:
        return f"{' '.join(error.cmd)}: {error.stderr.strip()}"


class ShapedLink:
    """The namespace behind the link; `host` is its address."""

    def __init__(self, name: str, devices: tuple[str, str], link: Link) -> None:
        self._name, self._link = name, link
        self.host = addresses()[1]
        self._here, self._device = devices
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._shape(link.steps[0].rate_bps)

    def inside(self, *command: str) -> list[str]:
        """`command`, to be run behind the link, where the machine's address is `host`."""
        return ["ip", "netns", "exec", self._name, *command]

    def start(self, after_bytes: int = 0) -> None:
        """Starts the clock of the link once `after_bytes` have passed; until then the link has the
        rate of its first step."""
        self._thread = threading.Thread(target=self._follow, args=(after_bytes,), daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        if self._thread is not None:
            self._thread.join()

    def _follow(self, after_bytes: int) -> None:
        passed = Path("/sys/class/net", self._here, "statistics", "rx_bytes")
        begin_bytes = int(passed.read_text())
        while int(passed.read_text()) - begin_bytes < after_bytes:
            if self._stop.wait(0.002):
                return
        next_s = time.monotonic()
        while True:
            for step in self._link.steps:
                self._shape(step.rate_bps)
                next_s += step.duration_s
                if self._stop.wait(max(0.0, next_s - time.monotonic())):
                    return

    def _shape(self, rate_bps: float) -> None:
        # A bucket for the fastest rate would pass too much at once while the link is slow.
        burst_bytes = max(LEAST_BURST_BYTES, round(rate_bps / 8 * BURST_S))
        fastest_bps = max(step.rate_bps for step in self._link.steps)
        queue_bytes = max(LEAST_QUEUE_BYTES, round(fastest_bps / 8 * QUEUE_S))
        rate = f"{round(max(LEAST_BPS, rate_bps))}bit"
        rule = f"tbf rate {rate} burst {burst_bytes} limit {queue_bytes}"
        run(*self.inside("tc", "qdisc", "replace", "dev", self._device, "root", *rule.split()))


def run(*command: str) -> None:
    subprocess.run(command, check=True, capture_output=True, text=True)


@contextmanager
def shaped_link(link: Link) -> Iterator[ShapedLink]:
    """A namespace that is reached over `link`; its latency is that of the queue alone."""
    name = f"swings-{os.getpid()}"
    here, there = f"sw{os.getpid()}a", f"sw{os.getpid()}b"
    near, far = addresses()
    run("ip", "netns", "add", name)
    try:
        run("ip", "link", "add", here, "type", "veth", "peer", "name", there, "netns", name)
        run("ip", "addr", "add", f"{near}/30", "dev", here)
        run("ip", "link", "set", here, "up")
        behind = ("ip", "-n", name)
        run(*behind, "addr", "add", f"{far}/30", "dev", there)
        # Packets are not merged: a packet longer than the bucket would never pass.
        run(*behind, "link", "set", there, "up", "gso_max_segs", "1")
        run(*behind, "link", "set", "lo", "up")
        shaped = ShapedLink(name, (here, there), link)
        try:
            yield shaped
        finally:
            shaped.close()
            # The namespace may exist for a while because of its remaining connections.
            run("ip", "link", "del", here)
    finally:
        run("ip", "netns", "del", name)
