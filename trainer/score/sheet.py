"""A contact sheet: capture, rendered picture and error side by side, for some frames and cameras;
below each, what moves there at twice the size."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from codec.arrays import Bytes, Floats
from codec.files import replacing
from codec.storage.openstorage import Target
from codec.stream.reader import DEFAULT_MAX_GAUSSIANS
from trainer.step.loss import psnr_db

from .truth import Movement, captured, displayed, movement_of, open_held_out

MAX_ROWS = 6
ERROR_GAIN = 4
"""The error is drawn this many times brighter."""
HEADER_PX = 16
"""Height of a label."""
ENLARGED = 2
"""Enlargement of the box with the moving pixels; enlarged, it is as large as the whole picture."""


def comparison(shown: Floats, truth: Floats) -> Bytes:
    """(H, 3 W, 3): capture, rendered and error beside each other; both (H, W, 3) in 0..1."""
    error = np.clip(ERROR_GAIN * np.abs(shown - truth), 0, 1)
    line: Bytes = np.rint(np.concatenate([truth, shown, error], axis=1) * 255).astype(np.uint8)
    return line


def enlarged_comparison(shown: Floats, truth: Floats, movement: Movement) -> Bytes | None:
    """`comparison` of the box with most moving pixels, enlarged; None where too few move."""
    height_px, width_px = (max(side // ENLARGED, 1) for side in truth.shape[:2])
    box = movement.busiest(height_px, width_px)
    if box is None:
        return None
    return comparison(shown[box], truth[box]).repeat(ENLARGED, axis=0).repeat(ENLARGED, axis=1)


def save_png(picture: Image.Image, target: Path) -> None:
    """Puts the picture at `target`, folders included: all of it or nothing."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with replacing(target) as temporary:
        picture.save(temporary, format="PNG")


def write_sheet(
    stream: Target,
    capture: Target,
    target: Path,
    max_gaussians: int | None = DEFAULT_MAX_GAUSSIANS,
) -> None:
    """Draws up to MAX_ROWS rows (frames spread over the stream, held-out cameras in turn) to a
    PNG, and what has moved since the frame before below each. Raises what `open_held_out`
    raises."""
    lines: list[Bytes] = []
    labels: list[str] = []
    with open_held_out(stream, capture, max_gaussians) as held_out:
        reader, manifest = held_out.reader, held_out.reader.manifest
        rows = min(MAX_ROWS, reader.num_frames)
        for row in range(rows):
            frame = round(row * (reader.num_frames - 1) / max(rows - 1, 1))
            which = row % len(held_out.cameras)
            camera, shot = held_out.cameras[which], held_out.shot(which, frame)
            splats = reader.active_splats(frame, manifest.num_layers)
            shown = displayed(splats, camera, manifest.near_of(camera))
            truth = captured(shot.picture)
            lines.append(comparison(shown, truth))
            score_db = psnr_db(shown, truth, shot.mask)
            labels.append(f"frame {frame}, camera {camera.name}: {score_db:.2f} dB")
            if frame == 0:
                continue
            movement = movement_of(held_out.shot(which, frame - 1), shot)
            moving = enlarged_comparison(shown, truth, movement)
            if moving is not None:
                moving_db = movement.psnr_db(shown, truth)
                lines.append(moving)
                labels.append(f"what moves, {ENLARGED} times as large: {moving_db:.2f} dB there")
    save_png(_labelled(lines, labels), target)


def _labelled(lines: Sequence[Bytes], labels: Sequence[str]) -> Image.Image:
    """The lines below each other, each below its label. They may differ in size, as cameras do."""
    width_px = max(line.shape[1] for line in lines)
    height_px = sum(HEADER_PX + line.shape[0] for line in lines)
    sheet = Image.new("RGB", (width_px, height_px), "black")
    draw = ImageDraw.Draw(sheet)
    top = 0
    for line, label in zip(lines, labels, strict=True):
        draw.text((4, top + 2), f"{label}   |   capture, rendered, error x{ERROR_GAIN}", "white")
        sheet.paste(Image.fromarray(line), (0, top + HEADER_PX))
        top += HEADER_PX + line.shape[0]
    return sheet
