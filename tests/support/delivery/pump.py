"""A play of made-up bytes to one client, as a process: `python -m tests.support.delivery.pump HOST
LEAST MOST SECONDS` fills a link of LEAST to MOST bit/s.

It works like server/play.py, with only the session between the socket and the clock. It prints its
port, and then the data on which the session decided: a line of JSON for each decision.
"""

from __future__ import annotations

import json
import socket
import sys
import time
from typing import NamedTuple

from server.abr.decisioncontext import SendSlices, SendSnapshots
from server.abr.session import PlaySession, SessionConfig
from server.abr.sweep import Sweep
from server.exchange.tcpinfo import unacked_bytes
from server.state.config import ServerConfig
from server.study.simulate.simulator import send_bytes
from tests.support.delivery.media import MadeMedia, sizes_of

FPS = 30


class Told(NamedTuple):
    """The data on which a session decides."""

    time_s: float
    rate_bps: float | None
    queued_bytes: float
    stalls: int


def wide_media(least_bps: float, most_bps: float, seconds: float) -> MadeMedia:
    """A stream whose layer 0 fits into `least_bps`, and whose layers exceed `most_bps`."""
    base_bps = 0.7 * least_bps
    upper_bps = (1.5 * most_bps - base_bps) / 3
    sizes = tuple(rate_bps / 8 / FPS for rate_bps in (base_bps, upper_bps, upper_bps, upper_bps))
    # Snapshots are sent in one piece: a long one alone would exceed what the link may hold.
    segments = (sizes_of(sizes, (25.5, 2.5, 1.1, 0.6), snapshot_bytes=sizes),)
    return MadeMedia(segments, round(FPS * seconds), segment_frames=30)


def tell(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def pump(connection: socket.socket, media: MadeMedia, lasts_s: float) -> None:
    began_s, poll_s, sent_bytes = time.monotonic(), ServerConfig().poll_s, 0
    session = PlaySession(media, Sweep(), SessionConfig(), 0.0)
    while (now_s := time.monotonic() - began_s) < lasts_s:
        session.acknowledge(now_s, sent_bytes - unacked_bytes(connection))
        decision = session.decide(now_s)
        told = Told(now_s, session.rate_bps, session.queued_bytes, session.clock.stalls)
        tell(json.dumps(told))
        if not isinstance(decision, SendSlices | SendSnapshots):
            time.sleep(poll_s)  # sleeps: as a play does in real time
            continue
        num_bytes = round(send_bytes(media, decision))
        session.sent(decision, num_bytes, now_s)
        connection.sendall(bytes(num_bytes))
        sent_bytes += num_bytes


def main() -> None:
    host, (least_bps, most_bps, lasts_s) = sys.argv[1], map(float, sys.argv[2:])
    with socket.create_server((host, 0)) as listener:
        tell(str(listener.getsockname()[1]))
        connection, _ = listener.accept()
        with connection:
            pump(connection, wide_media(least_bps, most_bps, lasts_s + 10), lasts_s)


if __name__ == "__main__":
    main()
