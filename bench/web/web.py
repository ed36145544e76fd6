"""Cost of a frame in the browser player: time of the page's own thread, and uploaded bytes.

Usage: scripts/bench web [--quick] [--rate RATE]

Streams like trained ones play once in headless Chromium. main: time of the page's thread in the
player's callbacks from one picture with a new order to the next, without the call that draws.
upload: the part of main that passes new data and the order to WebGL. decode and sort: time of the
workers for it. kB: data passed to WebGL for such a picture. all kB: the same in a mode that uploads
the texture of all Gaussians and the order on each sort, as the paper's viewer does; ratio: all kB
over kB. paper's: the ratio for that viewer's own texture and order, 36 bytes per Gaussian. A moving
camera turns in every picture, so that each picture is sorted. draw: time until the device has drawn
a picture. Nothing is drawn while the stream plays, because a device that is a CPU would take the
cores from the workers. If fewer pictures are made than frames are due, one picture uploads the data
of several frames: choose a lower rate.
"""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from codec.camera import Camera, look_at
from codec.console import run_command
from codec.errors import InvalidError
from codec.slice import Slice
from codec.slots.slotlayout import Update
from codec.stream import StreamWriter
from codec.stream.manifest import Manifest
from codec.tools.static import export_static
from tests.support.hosted_streams import static_host
from tests.support.slots.slot_streams import slot_manifest
from tests.support.slots.trained_updates import trained_like_layout, trained_like_updates
from tests.support.trained_like import ROOM_M, trained_like_slice
from tests.support.web.chromium import CHROMIUM, Page, running_chromium, why_not

ROOT = Path(__file__).parents[2]
NUM_FRAMES = 90
SEGMENT_FRAMES = 30
WIDTH_PX, HEIGHT_PX = 640, 360
ACTIVE = 0.3
"""Share of the slots that a slice changes, the trainer's default."""

PAPER_SWIN_SIZE = 5
PAPER_BYTES = 36
"""Bytes that the paper's viewer uploads for each Gaussian on each sort: two texels and its place in
the order."""

SIZES = (5_000, 50_000, 200_000)


@dataclass(frozen=True, slots=True)
class WebConfig:
    """Measures the browser player in player/web."""

    quick: bool = False
    """Measure only the smallest size."""
    rate: float = 1.0
    """Playback rate as a share of the streams' 30 frames per second."""


@dataclass(frozen=True, slots=True)
class Measured:
    """Figures of one play."""

    pictures: list[dict[str, float]]
    pictures_per_s: float
    stalls: int
    draw_ms: float
    """Milliseconds of drawing; 0 in the mode that uploads everything."""
    device: str

    @staticmethod
    def of(found: dict[str, Any]) -> Measured:
        """The figures of meter.js. Raises InvalidError if it has no picture."""
        if not found["pictures"]:
            raise InvalidError("this machine renders too few pictures; give a lower --rate")
        names = "pictures", "picturesPerS", "stalls", "drawMs", "device"
        return Measured(*(found[name] for name in names))

    def within(self, name: str, share: float = 0.5) -> float:
        """The quantile `share` of a figure over the pictures."""
        return float(np.quantile([picture[name] for picture in self.pictures], share))

    @property
    def upload_bytes(self) -> float:
        """Mean uploaded bytes per picture."""
        return fmean(picture["uploadBytes"] for picture in self.pictures)


def scene() -> dict[str, object]:
    """Fields of a manifest with a camera in the room of the trained-like Gaussians."""
    place = np.array([0.7 * ROOM_M, 0.4 * ROOM_M, 0.7 * ROOM_M])
    pose = look_at(place, np.array([0.0, 0.7, 0.0]), np.array([0.0, 1.0, 0.0]))
    focal_px = 0.8 * WIDTH_PX
    size = (WIDTH_PX, HEIGHT_PX, focal_px, focal_px, WIDTH_PX / 2, HEIGHT_PX / 2)
    bounds = ((-ROOM_M,) * 3, (ROOM_M,) * 3)
    cameras = (Camera("c0", *size, pose),)
    return {"bounds": bounds, "near_m": 0.1, "cameras": cameras}


def write(path: Path, manifest: Manifest, said: Iterable[Slice | Update]) -> Path:
    """Writes a stream and its static export; returns the folder of the export."""
    with StreamWriter.create(path / "stream", manifest) as writer:
        for one in said:
            writer.append(one)
    export_static(path / "stream", path / "static")
    return path / "static"


def write_slots(path: Path, num_gs: int) -> Path:
    layout = trained_like_layout(num_gs, 1, SEGMENT_FRAMES)
    manifest = slot_manifest(layout, **scene())
    return write(path, manifest, trained_like_updates(layout, NUM_FRAMES, ACTIVE))


def write_slices(path: Path, num_gs: int) -> Path:
    slice_size = num_gs // PAPER_SWIN_SIZE
    layout = trained_like_layout(slice_size, PAPER_SWIN_SIZE, SEGMENT_FRAMES)
    manifest = slot_manifest(layout, **scene())
    births = range(1 - PAPER_SWIN_SIZE, NUM_FRAMES)
    return write(path, manifest, (trained_like_slice(birth, slice_size) for birth in births))


KINDS = {
    f"{ACTIVE:.0%} of slots": write_slots,
    f"whole slices, swin_size {PAPER_SWIN_SIZE}": write_slices,
}
"""Writers of the streams, by the share of the Gaussians that is sent in a frame."""


def play(page: Page, url: str, rate: float, is_moving: bool, uploads_all: bool) -> Measured:
    page.open(url, WIDTH_PX, HEIGHT_PX)
    page.wait("document.querySelector('swings-player')?.player?.shownFrame >= 0", 120)
    how = {"rate": rate, "isMoving": is_moving, "uploadsAll": uploads_all}
    return Measured.of(page.run("return window.measure(value)", how))


def cells(ours: Measured, whole: Measured, num_gs: int) -> list[str]:
    times_ms = [ours.within("mainMs"), ours.within("mainMs", 0.95)]
    times_ms += [ours.within(f"{name}Ms") for name in ("upload", "decode", "sort")]
    paper_bytes = PAPER_BYTES * num_gs
    return [
        *(f"{ms:.2f}" for ms in times_ms),
        f"{ours.pictures_per_s:.0f}",
        str(ours.stalls),
        f"{ours.upload_bytes / 1e3:.0f}",
        f"{whole.upload_bytes / 1e3:.0f}",
        f"{whole.upload_bytes / ours.upload_bytes:.1f}x",
        f"{paper_bytes / ours.upload_bytes:.1f}x",
        f"{ours.draw_ms:.0f}",
    ]


def chromium_version() -> str:
    assert CHROMIUM is not None
    done = subprocess.run([CHROMIUM, "--version"], capture_output=True, text=True, check=True)
    return " ".join(done.stdout.split()[:2])


def run(config: WebConfig) -> None:
    reason = why_not()
    if reason is not None:
        raise InvalidError(reason)
    names = ["sent", "Gaussians", "camera", "main ms", "95 %", "upload ms", "decode ms"]
    names += ["sort ms", "pictures/s", "stalls", "kB", "all kB", "ratio", "paper's", "draw ms"]
    table = Table(*names, box=box.MARKDOWN)
    device = ""
    with tempfile.TemporaryDirectory() as name, running_chromium() as page:
        folder = Path(name)
        for part in ("player", "bench"):
            (folder / part).symlink_to(ROOT / part)
        with static_host(folder) as host:
            for num_gs in SIZES[:1] if config.quick else SIZES:
                for n, (kind, write_kind) in enumerate(KINDS.items()):
                    stream = write_kind(folder / f"{num_gs}-{n}", num_gs)
                    path = stream.relative_to(folder).as_posix()
                    url = f"{host}/bench/web/play.html?src=/{path}&autoplay=0&loop=0"
                    for camera in ("still", "moving"):
                        is_moving = camera == "moving"
                        ours = play(page, url, config.rate, is_moving, False)
                        whole = play(page, url, config.rate, is_moving, True)
                        table.add_row(kind, f"{num_gs:,}", camera, *cells(ours, whole, num_gs))
                        device = ours.device
    print(f"{chromium_version()}, {device}; {30 * config.rate:g} frames/s, {WIDTH_PX}x{HEIGHT_PX}")
    Console(width=200).print(table)


if __name__ == "__main__":
    run_command(WebConfig, run, "scripts/bench web", "Measures the browser player.")
