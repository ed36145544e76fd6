"""Frames drawn one by one: a picture of one, a film of a camera that goes around it, or depth and
masks of many."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from codec.camera import Camera
from codec.framerange import FrameRange
from codec.progressline import counted
from player.config import PictureKind, PlayConfig
from player.script.openscene import Scene
from player.show.sink import Picture, open_sink, to_bytes, write_picture
from player.view.path import CameraPath, Size, orbit


def draw_frames(config: PlayConfig) -> str:
    """Draws the frame of `config.still`, or those of `config.frames` if there is none, to
    `config.capture`; gives a line that says so.

    Nothing is fetched but what these frames need. Raises a SwingsError or an OSError, and leaves no
    half of a file then.
    """
    still, out = config.still, config.capture
    assert out is not None
    with Scene.open(
        config.source,
        layers=config.layers,
        renderer=config.renderer,
        gl=config.gl,
        delivery=config.delivery,
        max_gaussians=config.max_gaussians,
    ) as scene:
        if still is None:
            return _draw_each(config, scene, out)
        frame = still.of(scene.fps)
        scene.frames(frame, frame + 1)  # raises where there is no such frame
        if config.turntable is None:
            # As a capture of the whole stream shows it.
            whole = FrameRange(0, scene.num_frames)
            camera = config.camera.of(scene.manifest, config.size, whole)(frame)
            write_picture(out, _drawn(config, scene, frame, camera))
            drawn, size = "a picture", Size(camera.width_px, camera.height_px)
        else:
            count = max(1, round(config.turntable * scene.fps))
            path = _around(config, scene, count)
            first = path(0)
            size = Size(first.width_px, first.height_px)
            with open_sink(out, scene.fps, size) as sink, counted("drawing") as show:
                for number in range(count):
                    sink.write(number, _drawn(config, scene, frame, path(number)))
                    show(number + 1, count)
            drawn = f"{count} pictures"
        return (
            f"{drawn} of frame {frame} of {scene.name}, {size.width_px}x{size.height_px}, "
            f"by {scene.renderer or 'CPU'}: {out}"
        )


def _draw_each(config: PlayConfig, scene: Scene, out: Path) -> str:
    frames = config.frames.of(scene.num_frames, scene.name)
    path = config.camera.of(scene.manifest, config.size, FrameRange(frames.start, frames.stop))
    first = path(frames.start)
    size = Size(first.width_px, first.height_px)
    with open_sink(out, scene.fps, size) as sink, counted("drawing") as show:
        for frame in frames:
            sink.write(frame, _drawn(config, scene, frame, path(frame)))
            show(frame - frames.start + 1, len(frames))
    return (
        f"{len(frames)} pictures of {config.picture} of {scene.name}, "
        f"{size.width_px}x{size.height_px}, by {scene.renderer or 'CPU'}: {out}"
    )


def _drawn(config: PlayConfig, scene: Scene, frame: int, camera: Camera) -> Picture:
    """The picture of `config.picture`, as it is written."""
    match config.picture:
        case PictureKind.DEPTH:
            depth_mm = 1000 * np.nan_to_num(scene.depth(frame, camera))
            return np.rint(np.minimum(depth_mm, np.iinfo(np.uint16).max)).astype(np.uint16)
        case PictureKind.MASK:
            return to_bytes(scene.render(frame, camera, background=None)[:, :, 3])
    return to_bytes(scene.render(frame, camera, background=config.background))


def _around(config: PlayConfig, scene: Scene, count: int) -> CameraPath:
    """The cameras of `count` pictures: once around from one that stands, else the path itself."""
    pictures = FrameRange(0, count)
    path = config.camera.of(scene.manifest, config.size, pictures)
    if config.camera.moves:
        return path
    return orbit(scene.manifest, path(0), pictures, 2 * math.pi)
