"""A contact sheet: capture, rendered picture and error side by side, for some frames and
cameras."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw

from codec.files import replacing
from codec.stream import StreamReader
from player.render.cpu import render_splats
from trainer.capture.layout import open_capture
from trainer.errors import CaptureError
from trainer.pictures.framecache import FrameCache
from trainer.step.loss import psnr_db

from .evaluate import displayed, stream_cameras

Floats = npt.NDArray[np.float32]

MAX_ROWS = 6
ERROR_GAIN = 4
"""The error is drawn this many times brighter."""


def comparison(shown: Floats, truth: Floats) -> npt.NDArray[np.uint8]:
    """(H, 3 W, 3): capture, rendered and error beside each other; both (H, W, 3) in 0..1."""
    error = np.clip(ERROR_GAIN * np.abs(shown - truth), 0, 1)
    line: npt.NDArray[np.uint8] = np.rint(
        np.concatenate([truth, shown, error], axis=1) * 255
    ).astype(np.uint8)
    return line


def save_png(picture: Image.Image, target: Path) -> None:
    """Puts the picture at `target`, folders included: all of it or nothing."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with replacing(target) as temporary:
        picture.save(temporary, format="PNG")


def write_sheet(stream: Path, capture_path: Path, target: Path) -> None:
    """Draws up to MAX_ROWS rows (frames spread over the stream, held-out cameras in turn) to a
    PNG."""
    reader = StreamReader(stream)
    manifest = reader.manifest
    capture = open_capture(capture_path)
    if not capture.held_out:
        raise CaptureError(f"{capture.root}: no held-out camera to compare with")
    cameras = stream_cameras(manifest, capture, str(stream))
    frames = range(manifest.capture_frame, manifest.capture_frame + reader.num_frames)
    rows = min(MAX_ROWS, reader.num_frames)
    lines: list[npt.NDArray[np.uint8]] = []
    labels: list[str] = []
    with FrameCache(capture, frames, cameras=cameras) as cache:
        for row in range(rows):
            frame = round(row * (reader.num_frames - 1) / max(rows - 1, 1))
            index = capture.held_out[row % len(capture.held_out)]
            camera = cache.camera(index)
            truth = cache.image(index, frames[frame]).astype(np.float32) / np.float32(255)
            splats = reader.active_splats(frame, manifest.num_layers)
            shown = displayed(render_splats(splats, camera, manifest.near_m))
            lines.append(comparison(shown, truth))
            score_db = psnr_db(shown, truth, cache.mask(index, frames[frame]))
            labels.append(f"frame {frame}, camera {camera.name}: {score_db:.2f} dB")
    height_px, width_px = lines[0].shape[:2]
    header_px = 16
    sheet = Image.new("RGB", (width_px, len(lines) * (height_px + header_px)), "black")
    draw = ImageDraw.Draw(sheet)
    for row, (line, label) in enumerate(zip(lines, labels, strict=True)):
        top = row * (height_px + header_px)
        draw.text((4, top + 2), f"{label}   |   capture, rendered, error x{ERROR_GAIN}", "white")
        sheet.paste(Image.fromarray(line), (0, top + header_px))
    save_png(sheet, target)
