"""Loops, seeks and scrubbing of the browser player over a slow link: time and bytes.

Usage: scripts/bench seeks [--stream PATH] [--link 4M,50ms]

A paused page seeks to frames that it has not received. single: one seek. quick: eight seeks, 100 ms
apart, timed from the last one on. again: a seek into a segment that has been received. base: time
until the frame shows with any number of layers; all: time until it shows with all layers. scrub:
the thumb moves over twenty places, 100 ms apart; the table has the number of pictures shown. loop:
bytes received in the first round, and in each later one. Bytes from a server are counted decoded,
as the page receives them.
"""

from __future__ import annotations

import random
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Annotated

from rich import box
from rich.console import Console
from rich.table import Table

from bench.serve.processes import serving
from codec.console import option, run_command
from codec.errors import InvalidError
from codec.stream import StreamReader, StreamWriter
from codec.tools.static import export_static
from player.link.linkprocess import LinkProcess
from player.link.relay import read_link
from server.abr.link import Link
from tests.support.hosted_streams import static_host
from tests.support.slots.slot_streams import slot_manifest
from tests.support.slots.trained_updates import trained_like_layout, trained_like_updates
from tests.support.web.chromium import Page, running_chromium, why_not

ROOT = Path(__file__).parents[2]
SEGMENT_FRAMES = 30
LINK = "4M,50ms"
PLAYER = "document.querySelector('swings-player').player"

SEEK = """
const player = document.querySelector("swings-player").player;
const rest = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
const until = async (isSo) => {
  const endMs = performance.now() + 60000;
  while (!isSo()) {
    if (performance.now() > endMs) throw new Error(JSON.stringify(player.state));
    await rest(4);
  }
};
const beforeBytes = player.state.receivedBytes;
const last = value.at(-1);
for (const frame of value.slice(0, -1)) {
  player.seek(frame);
  await rest(100);
}
const beganMs = performance.now();
player.seek(last);
await until(() => player.shownFrame === last && !player.isSeeking);
const baseMs = performance.now() - beganMs;
await until(() => player.state.frame === last && player.state.layers === player.manifest.numLayers);
const allMs = performance.now() - beganMs;
return { baseMs, allMs, bytes: player.state.receivedBytes - beforeBytes };
"""

SCRUB = """
const player = document.querySelector("swings-player").player;
const shown = new Set();
const note = () => shown.add(player.shownFrame);
const beforeBytes = player.state.receivedBytes;
player.addEventListener("shown", note);
for (const frame of value) {
  player.scrub(frame);
  await new Promise((resolve) => setTimeout(resolve, 100));
}
player.removeEventListener("shown", note);
player.seek(value.at(-1));
return shown.size;
"""

LOOP = """
const player = document.querySelector("swings-player").player;
let [waits, last] = [0, player.state.frame];
document.querySelector("swings-player").addEventListener("waiting", () => waits++);
player.setLoop(true);
player.setPlaying(true);
const rounds = [];
await new Promise((resolve) => {
  player.addEventListener("state", () => {
    const { frame, receivedBytes } = player.state;
    if (frame < last) rounds.push({ receivedBytes, waits });
    last = frame;
    if (rounds.length === value) resolve();
  });
});
return rounds;
"""


@dataclass(frozen=True, slots=True)
class SeeksConfig:
    """Measures loops, seeks and scrubbing of the browser player over an emulated link."""

    stream: Path | None = None
    """A stream to play; by default a synthetic stream that resembles a trained stream."""
    link: Annotated[Link, option("RATE|TRACE", read_link)] = field(
        default_factory=lambda: read_link(LINK)
    )
    """The link, as for swings-play."""
    repeats: int = 5
    """Number of seeks of each kind."""
    rounds: int = 6
    """Rounds of the loop."""
    num_gs: int = 4_000
    """Gaussians of the synthetic stream."""
    num_frames: int = 900
    """Frames of the synthetic stream."""


def make_stream(path: Path, num_gs: int, num_frames: int) -> None:
    layout = trained_like_layout(num_gs, 1, SEGMENT_FRAMES)
    with StreamWriter.create(path, slot_manifest(layout)) as writer:
        for update in trained_like_updates(layout, num_frames, 0.3):
            writer.append(update)


@contextmanager
def slow(url: str, path: str, link: Link) -> Iterator[str]:
    """Gives the URL of a page behind the link."""
    with LinkProcess(link, "127.0.0.1", int(url.rpartition(":")[2])) as process:
        host, port = process.address
        yield f"http://{host}:{port}{path}"


@contextmanager
def on_host(folder: Path, kind: str, name: str, link: Link) -> Iterator[str]:
    if kind == "static host":
        with (
            static_host(folder) as url,
            slow(url, "/web/bundle/watch.html?src=../../", link) as page,
        ):
            yield f"{page}{name}-static&autoplay=0"
    else:
        log = folder / "log"
        with (
            serving(folder, log=log) as (_, port),
            slow(f"http://127.0.0.1:{port}", "/watch/", link) as page,
        ):
            yield f"{page}{name}?autoplay=0"


def measure(page: Page, url: str, loop_url: str, config: SeeksConfig, table: Table) -> None:
    kind = "static host" if "static" in url else "server"

    def opened(at: str) -> None:
        page.open(at, 160, 120)
        page.wait(f"{PLAYER}?.shownFrame >= 0", 120)

    def add(name: str, found: list[dict[str, float]]) -> None:
        cells = [median(one[key] for one in found) for key in ("baseMs", "allMs", "bytes")]
        table.add_row(kind, name, *(f"{cell:,.0f}" for cell in cells), "")

    rng = random.Random(0)
    opened(url)
    num_frames = page.run(f"return {PLAYER}.numFrames")
    singles: list[dict[str, float]] = []
    quicks: list[dict[str, float]] = []
    agains: list[dict[str, float]] = []
    for _ in range(config.repeats):
        for count, found in ((1, singles), (8, quicks)):
            opened(url)
            # Frames beyond those that a page fetches ahead from frame 0.
            frames = rng.sample(range(num_frames * 6 // 10, num_frames), count)
            found.append(page.run(SEEK, frames))
        agains.append(page.run(SEEK, [frames[-1] // SEGMENT_FRAMES * SEGMENT_FRAMES + 7]))
    add("single", singles)
    add("quick", quicks)
    add("again", agains)
    opened(url)
    places = [num_frames // 3 + n * num_frames // 40 for n in range(20)]
    table.add_row(kind, "scrub", "", "", "", f"{page.run(SCRUB, places)} of 20 pictures")
    opened(loop_url)
    rounds = page.run(LOOP, config.rounds)
    first, last = rounds[0], rounds[-1]
    later = (last["receivedBytes"] - first["receivedBytes"]) / (len(rounds) - 1)
    waits = last["waits"] - first["waits"]
    note = f"then {later:,.0f} a round, {waits} waits"
    table.add_row(kind, "loop", "", "", f"{first['receivedBytes']:,.0f}", note)


def run(config: SeeksConfig) -> None:
    reason = why_not()
    if reason is not None:
        raise InvalidError(reason)
    table = Table("from", "", "base ms", "all ms", "bytes", "note", box=box.MARKDOWN)
    with tempfile.TemporaryDirectory() as name, running_chromium() as page:
        folder = Path(name)
        (folder / "web").symlink_to(ROOT / "player" / "web")
        long = folder / "long"
        if config.stream is None:
            make_stream(long, config.num_gs, config.num_frames)
        else:
            shutil.copytree(config.stream, long)
        make_stream(folder / "short", config.num_gs, 2 * SEGMENT_FRAMES)
        for stream in ("long", "short"):
            export_static(folder / stream, folder / f"{stream}-static")
        reader = StreamReader(long)
        size = sum(sum(record.part_bytes) for record in reader.records)
        for kind in ("static host", "server"):
            with (
                on_host(folder, kind, "long", config.link) as url,
                on_host(folder, kind, "short", config.link) as loop_url,
            ):
                measure(page, url, loop_url, config, table)
    print(f"{reader.num_frames} frames, {8e-6 * size * 30 / reader.num_frames:.1f} Mbit/s")
    Console(width=120).print(table)


if __name__ == "__main__":
    run_command(SeeksConfig, run, "scripts/bench seeks", "Measures seeks of the browser player.")
