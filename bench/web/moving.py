"""Films the browser player in headless Chromium: docs/watch.webp.

The player is stepped frame by frame while the camera swings around the scene, so that the result
does not depend on the drawing speed of this machine.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import tyro
from PIL import Image

from codec.console import run_command
from codec.errors import InvalidError
from tests.support.commands import serving
from tests.support.web.canvas import PIXELS
from tests.support.web.chromium import Page, running_chromium, why_not

WIDTH_PX, HEIGHT_PX = 640, 360
TURN_RAD, TILT_RAD, ZOOM = 0.55, 0.10, 0.85


@dataclass(frozen=True, slots=True)
class MovingConfig:
    """The film and its stream."""

    stream: tyro.conf.Positional[Path]
    """Folder of a stream, such as demo/stream."""
    out: Path = Path("docs/watch.webp")
    """The animated WebP to write."""
    pictures: int = 60
    """Number of pictures."""
    frames_per_picture: int = 2
    """Step between pictures, in frames of the stream."""
    picture_ms: int = 67
    """Duration of each picture, milliseconds."""
    quality: int = 60
    """Quality of the WebP, 0 to 100; a lower value makes a smaller file."""


def film(page: Page, config: MovingConfig, folder: Path) -> list[Path]:
    """The pictures, as PNGs in `folder`."""
    page.wait("player.shownFrame >= 0", 60)
    count = page.value("player.manifest.numLayers")
    fps = page.value("player.manifest.fps")
    num_frames = page.value("Math.round(element.duration * player.manifest.fps)")
    paths = []
    for number in range(config.pictures):
        phase_rad = 2 * math.pi * number / config.pictures
        turn, tilt = TURN_RAD * math.sin(phase_rad), TILT_RAD * math.sin(2 * phase_rad)
        frame = number * config.frames_per_picture % num_frames
        time_s = (frame + 0.01) / fps
        page.run(f"element.view = '{turn},{tilt},{ZOOM},0,0'; element.currentTime = {time_s};")
        page.wait(f"player.shownFrame === {frame} && state.layers >= {count}", 30)
        page.run("await window.readCanvas(player);")
        # Keeps the controls visible.
        page.run("element.dispatchEvent(new PointerEvent('pointermove', { bubbles: true }));")
        paths.append(folder / f"{number:04d}.png")
        page.screenshot(paths[-1])
    return paths


def run(config: MovingConfig) -> None:
    missing = why_not()
    if missing is not None:
        raise InvalidError(missing)
    with TemporaryDirectory() as folder, serving(config.stream) as url, running_chromium() as page:
        address = f"{url.rstrip('/')}/watch/{config.stream.resolve().name}?autoplay=0&loop=0"
        page.open(address, WIDTH_PX, HEIGHT_PX, scripts=[PIXELS])
        paths = film(page, config, Path(folder))
        first, *others = [Image.open(path).convert("RGB") for path in paths]
    first.save(
        config.out,
        save_all=True,
        append_images=others,
        duration=config.picture_ms,
        loop=0,
        quality=config.quality,
        method=6,
    )
    print(f"{config.out}: {config.pictures} pictures, {config.out.stat().st_size} bytes")


if __name__ == "__main__":
    run_command(MovingConfig, run, "scripts/bench moving", "Films the browser player.")
