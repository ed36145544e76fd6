"""A small stream, and the capture that it is scored against."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout
from tests.support.tiny_capture import write_dynamic3dgs
from trainer.capture.layout import open_capture

FRAMES = 6

NEAR: dict[str, dict[str, Any]] = {
    "every": {"near_m": 6.9},
    "own": {"camera_near_m": (6.9,) * 4},
    "none": {},
}
"""Changes of a manifest that set near planes: one plane for every view, the same plane as each
camera's own, and none."""


def write_scored(path: Path, swin_size: int = 2, **changes: object) -> tuple[Path, Path]:
    """Writes a stream of FRAMES frames and two layers, and its capture, whose camera 1 is held out;
    returns the folders of both. changes: fields of the manifest."""
    capture, stream = path / "capture", path / "stream"
    path.mkdir(exist_ok=True)
    write_dynamic3dgs(capture, num_cameras=4, num_frames=FRAMES)
    cameras = tuple(c.camera for c in open_capture(capture).cameras)
    layout = small_layout(swin_size, (60, 40), 0, 4)
    changes = {"cameras": cameras, "default_camera": cameras[0].name, **changes}
    write_busy_stream(stream, FRAMES, layout, **changes)
    return stream, capture
