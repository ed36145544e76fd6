"""Start of the browser player: seconds from opening the page to the first picture on a long link.

Usage: scripts/bench pagestart [--rounds N] [--rtt-ms MS]

swings-serve serves a stream of 10,000 Gaussians like trained ones, behind a TCP proxy that adds
half of the round trip each way, and a whole round trip for the handshake of each connection.
Chromium opens the page with an empty cache (cold) and, 2 s after closing it, once more (warm), for
each page in turn. bundle: the page that the server sends. frame: the page for frames, which
expects a static host. The first picture is the first frame of the stream, not its poster. GETs
and kB: on the link until then, with page, poster and stream.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import median

from rich import box
from rich.console import Console
from rich.table import Table

from bench.web.slowlink import SlowLink, slow_link
from bench.web.web import NUM_FRAMES, SEGMENT_FRAMES, chromium_version, scene
from codec.console import run_command
from codec.errors import InvalidError
from codec.stream import StreamWriter
from codec.stream.poster import POSTER_NAME, write_poster
from player.render.cpu import render_splats
from tests.support.hosted_streams import served, wait_for_stream
from tests.support.slots.slot_streams import slot_manifest
from tests.support.slots.trained_updates import trained_like_layout, trained_like_updates
from tests.support.web.chromium import Page, running_chromium, why_not

NUM_GS = 10_000
ACTIVE = 0.3
PAGES = {
    "bundle": "/watch/room",
    "frame": "/web/bundle/watch.html?src=/v1/streams/room",
}
REST_S = 2.0
"""Rest before a warm start: Chromium still ends a page for a while after closing it."""
SCRIPT = Path(__file__).parent / "firstpicture.js"


@dataclass(frozen=True, slots=True)
class PageStartConfig:
    """Measures the start time of the browser player."""

    rounds: int = 5
    """Cold and warm starts of each page; the table has their medians."""
    rtt_ms: float = 100.0
    """Round-trip time of the link, milliseconds."""


@dataclass(slots=True)
class Starts:
    """Times, requests and bytes of the starts of one kind."""

    seconds: list[float] = field(default_factory=list)
    requests: list[int] = field(default_factory=list)
    received_bytes: list[int] = field(default_factory=list)

    def add(self, page: Page, link: SlowLink) -> None:
        """Waits for the first picture of `page`, which was just opened."""
        page.wait("window.firstPictureMs", 60)
        # Only GETs count: the number of status updates depends on the time of the start.
        self.requests.append(sum(line.startswith("GET") for line in link.requests))
        self.received_bytes.append(link.received_bytes)
        self.seconds.append(page.run("return window.firstPictureMs") / 1000)

    def cells(self) -> list[str]:
        """Median, range, requests and kB for a table."""
        return [
            f"{median(self.seconds):.2f}",
            f"{min(self.seconds):.2f} to {max(self.seconds):.2f}",
            f"{median(self.requests):.0f}",
            f"{median(self.received_bytes) / 1e3:.0f}",
        ]


def write(path: Path) -> None:
    """Writes a stream with a poster to `path`."""
    layout = trained_like_layout(NUM_GS, 1, SEGMENT_FRAMES)
    manifest = replace(slot_manifest(layout, **scene()), poster=POSTER_NAME)
    with StreamWriter.create(path, manifest) as writer:
        for one in trained_like_updates(layout, NUM_FRAMES, ACTIVE):
            writer.append(one)
    write_poster(path, render_splats)


def run(config: PageStartConfig) -> None:
    reason = why_not()
    if reason is not None:
        raise InvalidError(reason)
    starts = {(name, kind): Starts() for name in PAGES for kind in ("cold", "warm")}
    with tempfile.TemporaryDirectory() as name:
        write(Path(name) / "room")
        with served(Path(name)) as server, running_chromium() as page:
            wait_for_stream(server, "room")
            with slow_link(server.port, config.rtt_ms / 1000) as link:
                for _ in range(config.rounds):
                    for name, path in PAGES.items():
                        link.reset()
                        page.open(f"http://127.0.0.1:{link.port}{path}", scripts=[SCRIPT])
                        starts[name, "cold"].add(page, link)
                        link.reset()
                        page.reopen(REST_S)
                        starts[name, "warm"].add(page, link)
                        page.close()
    columns = ["page", "start", "median s", "range s", "GETs", "kB"]
    table = Table(*columns, box=box.MARKDOWN)
    for (name, kind), found in starts.items():
        table.add_row(name, kind, *found.cells())
    print(f"{chromium_version()}; round trip {config.rtt_ms:g} ms, {config.rounds} rounds")
    Console(width=120).print(table)


if __name__ == "__main__":
    run_command(
        PageStartConfig, run, "scripts/bench pagestart", "Measures the browser player's start."
    )
