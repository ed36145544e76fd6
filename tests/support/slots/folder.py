"""Tiny streams of random updates in a folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from codec.camera import Camera
from codec.slots.slotlayout import SlotLayout, Update
from codec.stream import StreamWriter
from codec.stream.manifest import Manifest
from tests.support.slots.updates import patternless_updates, small_layout


def slots_manifest(layout: SlotLayout | None = None) -> Manifest:
    """The manifest of a stream of `layout`; by default two layers, a swin_size of 3 and segments of
    4 frames."""
    layout = small_layout(3, (9, 6), 0, 4) if layout is None else layout
    return Manifest(
        fps=25.0,
        swin_size=layout.swin_size,
        segment_frames=layout.segment_frames,
        sh_degree=layout.sh_degree,
        antialias=False,
        near_m=0.1,
        bounds=((-3.0, -3.0, -3.0), (3.0, 3.0, 3.0)),
        cameras=(Camera("front", 64, 48, 50.0, 50.0, 32.0, 24.0, np.eye(4)),),
        default_camera="front",
        live=True,
        title="slots",
        slots=layout.slots,
        lattice=layout.lattices,
    )


def write_slots(
    path: Path, num_frames: int, layout: SlotLayout | None = None, seed: int = 0
) -> list[Update]:
    """Writes a finished stream of `num_frames` frames to `path`; returns its updates."""
    manifest = slots_manifest(layout)
    updates = patternless_updates(manifest.slot_layout, num_frames, seed)
    with StreamWriter.create(path, manifest) as writer:
        for update in updates:
            writer.append(update)
    return updates
