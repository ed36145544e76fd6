"""A stream beside what one camera of its capture saw, frame by frame: truth, rendered, error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from PIL import Image, ImageDraw, ImageFont

from codec.arrays import Bytes, Floats
from codec.camera import Camera
from codec.errors import InvalidError
from player.show.sink import open_sink
from player.view.path import Size
from trainer.capture.capture import Mask
from trainer.pictures.framecache import FrameCache
from trainer.step.loss import psnr_db

from .evaluate import EvaluateConfig
from .truth import captured, displayed, open_held_out

MOST_ERROR = 64 / 255
"""Error at the bright end of the colour bar, and what lies above it: the mean of the channels."""

_PALETTE: Bytes = np.rint(colormaps["inferno"](np.linspace(0, 1, 256))[:, :3] * 255).astype(
    np.uint8
)


@dataclass(frozen=True, slots=True)
class SideBySide:
    """Result of a comparison: camera, frames, PSNR, and the film."""

    camera: str
    frames: int
    psnr_db: float
    """Mean over the frames."""
    out: Path

    @property
    def line(self) -> str:
        """For people."""
        return f"{self.frames} frames from {self.camera}, {self.psnr_db:.2f} dB: {self.out}"


def error_colours(error: Floats) -> Bytes:
    """(..., 3) the colours of errors, 0..1, on the bar's scale."""
    levels = np.rint(np.clip(error / MOST_ERROR, 0, 1) * 255).astype(np.uint8)
    colours: Bytes = _PALETTE[levels]
    return colours


def side_by_side(truth: Floats, shown: Floats, mask: Mask | None, labels: tuple[str, str]) -> Bytes:
    """(header + H, 3 W, 3): truth, shown and error, each below its label; both (H, W, 3) in 0..1.

    The error is black where the mask does not count. labels: of truth and shown.
    """
    height_px, width_px = truth.shape[:2]
    error = np.abs(shown - truth).mean(axis=2)
    if mask is not None:
        error = np.where(mask > 0, error, 0)
    panels = [np.rint(panel * 255).astype(np.uint8) for panel in (truth, shown)]
    panels.append(error_colours(error))
    headers = [_header(width_px, height_px, label) for label in labels]
    headers.append(_bar(width_px, height_px))
    return np.concatenate(
        [np.concatenate(column, axis=0) for column in zip(headers, panels, strict=True)], axis=1
    )


def _header_px(height_px: int) -> int:
    return max(14, height_px // 20)


def _header(width_px: int, height_px: int, text: str) -> Bytes:
    """A line of text as wide as a panel; what does not fit is cut off."""
    header_px = _header_px(height_px)
    image = Image.new("RGB", (width_px, header_px), "black")
    font = ImageFont.load_default(0.7 * header_px)
    ImageDraw.Draw(image).text((4, header_px / 2), text, "white", font, anchor="lm")
    return np.asarray(image)


def _bar(width_px: int, height_px: int) -> Bytes:
    """The scale of the errors' colours, in levels of 255, in the right half of a header; none where
    there is no room."""
    header_px, half_px = _header_px(height_px), width_px // 2
    left, right = width_px - half_px + header_px, width_px - 2 * header_px
    if right - left < 2 * header_px:
        return _header(width_px, height_px, "error")
    header = _header(width_px, height_px, "error, of 255").copy()
    header[:, -half_px:] = _header(half_px, height_px, "0")
    header[:, right:] = _header(width_px - right, height_px, f"{MOST_ERROR * 255:.0f}+")
    colours = error_colours(np.linspace(0, MOST_ERROR, right - left, dtype=np.float32))
    header[2:-2, left:right] = colours
    return header


def _find(cache: FrameCache, name: str) -> tuple[int, Camera]:
    """The number and the camera of the capture's that is called `name`."""
    names = [camera.camera.name for camera in cache.capture.cameras]
    if name not in names:
        raise InvalidError(
            f"{cache.capture.root} has no camera {name!r}; it has {', '.join(names)}"
        )
    return names.index(name), cache.camera(names.index(name))


def write_side_by_side(
    config: EvaluateConfig,
    name: str,
    out: Path,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> SideBySide:
    """Draws the frames that `config` chooses from the camera `name`, held out or not, to an .mp4 or
    a folder of PNGs. on_progress(pictures done, in all).

    Raises InvalidError for a camera that the capture does not have, and what `open_held_out` and
    `open_sink` raise.
    """
    with open_held_out(config.stream, config.capture, config.max_gaussians) as held_out:
        reader, cache = held_out.reader, held_out.cache
        manifest, frames = reader.manifest, held_out.every(config.every)
        number, camera = _find(cache, name)
        size = Size(3 * camera.width_px, camera.height_px + _header_px(camera.height_px))
        scores = []
        with open_sink(out, manifest.fps / config.every, size) as sink:
            for done, frame in enumerate(frames, 1):
                shot = cache.shot(number, cache.frames[frame])
                splats = reader.active_splats(frame, manifest.num_layers)
                truth = captured(shot.picture)
                shown = displayed(splats, camera, manifest.near_of(camera))
                scores.append(psnr_db(shown, truth, shot.mask))
                labels = (f"{name}, frame {frame}", f"rendered, {scores[-1]:.2f} dB")
                sink.write(frame, side_by_side(truth, shown, shot.mask, labels))
                on_progress(done, len(frames))
    return SideBySide(name, len(scores), float(np.mean(scores)), out)
