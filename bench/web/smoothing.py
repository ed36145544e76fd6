"""Cost of motion between frames in the browser: time of the page's own thread, uploads, and time of
the device.

Usage: scripts/bench smoothing [--gaussians N] [--rate RATE]

A stream of slots that go on plays in headless Chromium, in turns with each frame held and with
motion between frames. main: time of the page's thread in the player's callbacks during a second,
without the call that draws, divided by the pictures drawn in it, and by its frames. kB: data passed
to WebGL per frame. draw: time until the device has drawn a picture, with the Gaussians at their
places and halfway to them; also in turns.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean, median

from rich import box
from rich.console import Console
from rich.table import Table

from bench.web.web import HEIGHT_PX, ROOT, WIDTH_PX, chromium_version, scene, write
from codec.console import run_command
from codec.errors import InvalidError
from tests.support.hosted_streams import static_host
from tests.support.slots.moving_updates import moving_updates
from tests.support.slots.slot_streams import slot_manifest
from tests.support.slots.trained_updates import trained_like_layout
from tests.support.web.chromium import Page, running_chromium, why_not

NUM_FRAMES, SEGMENT_FRAMES = 90, 30


@dataclass(frozen=True, slots=True)
class SmoothingConfig:
    """Measures motion between frames in player/web."""

    gaussians: tuple[int, ...] = (5_000, 50_000)
    """Numbers of slots; half of the slots move in a frame."""
    rate: float = 1.0
    """Playback rate as a share of the stream's 30 frames per second."""
    turns: int = 3
    """Plays of each kind."""


@dataclass(frozen=True, slots=True)
class Turn:
    """Mean figures of one play."""

    main_ms_a_picture: float
    main_ms_a_frame: float
    pictures_per_s: float
    bytes_a_frame: float


def play(page: Page, url: str, rate: float, interpolates: bool) -> Turn:
    page.open(f"{url}&interpolate={str(interpolates).lower()}", WIDTH_PX, HEIGHT_PX)
    page.wait("player.shownFrame >= 0", 120)
    how = {"rate": rate, "isMoving": False, "uploadsAll": False}
    found = page.run("return window.measure(value)", how)
    frames = found["pictures"]
    if not frames:
        raise InvalidError("this machine renders too few pictures; give a lower --rate")
    main_ms = fmean(frame["mainMs"] for frame in frames)
    drawn = found["drawnPerS"] / found["picturesPerS"]
    num_bytes = fmean(frame["uploadBytes"] for frame in frames)
    return Turn(main_ms / drawn, main_ms, found["drawnPerS"], num_bytes)


def run(config: SmoothingConfig) -> None:
    reason = why_not()
    if reason is not None:
        raise InvalidError(reason)
    names = ["Gaussians", "frames", "main ms a picture", "a frame", "pictures/s", "kB a frame"]
    table = Table(*names, "draw ms", box=box.MARKDOWN)
    with tempfile.TemporaryDirectory() as name, running_chromium() as page:
        folder = Path(name)
        for part in ("player", "bench"):
            (folder / part).symlink_to(ROOT / part)
        with static_host(folder) as host:
            for num_gs in config.gaussians:
                layout = trained_like_layout(num_gs, 1, SEGMENT_FRAMES)
                manifest = slot_manifest(layout, **scene())
                stream = write(folder / str(num_gs), manifest, moving_updates(layout, NUM_FRAMES))
                path = stream.relative_to(folder).as_posix()
                url = f"{host}/bench/web/play.html?src=/{path}&autoplay=0&loop=0"
                turns: tuple[list[Turn], list[Turn]] = ([], [])
                for _ in range(config.turns):
                    for on in (False, True):
                        turns[on].append(play(page, url, config.rate, on))
                draw_ms = page.run("return window.measureBetween()")
                for kind, found, times in zip(("held", "in motion"), turns, draw_ms, strict=True):
                    values = [
                        f"{median(one.main_ms_a_picture for one in found):.2f}",
                        f"{median(one.main_ms_a_frame for one in found):.2f}",
                        f"{median(one.pictures_per_s for one in found):.0f}",
                        f"{median(one.bytes_a_frame for one in found) / 1e3:.0f}",
                        f"{median(times):.1f}",
                    ]
                    table.add_row(f"{num_gs:,}", kind, *values)
        version = chromium_version()
    print(f"{version}, {30 * config.rate:g} frames/s, {WIDTH_PX}x{HEIGHT_PX}")
    Console(width=160).print(table)


if __name__ == "__main__":
    description = "Measures motion between frames in the browser player."
    run_command(SmoothingConfig, run, "scripts/bench smoothing", description)
