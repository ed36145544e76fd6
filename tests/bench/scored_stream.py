"""A small stream beside the capture that it is scored against."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from codec.profiles.profile import Profile
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout
from tests.support.tiny_capture import write_dynamic3dgs
from tests.support.tiny_stream import tiny_manifest, write_tiny
from trainer.capture.layout import open_capture

FRAMES = 6


def write_scored(path: Path, version: int) -> tuple[Path, Path]:
    """The folders of a stream of FRAMES frames and two layers, and of its capture, whose camera 1
    is held out."""
    capture, stream = path / "capture", path / "stream"
    write_dynamic3dgs(capture, num_cameras=4, num_frames=FRAMES)
    cameras = tuple(c.camera for c in open_capture(capture).cameras)
    default = cameras[0].name
    if version == 1:
        manifest = replace(tiny_manifest(Profile.COMPACT), cameras=cameras, default_camera=default)
        write_tiny(stream, FRAMES, manifest)
    else:
        layout = small_layout(2, (60, 40), 0, 4)
        write_busy_stream(stream, FRAMES, layout, cameras=cameras, default_camera=default)
    return stream, capture
