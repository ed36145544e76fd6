"""The interactive window; controls.py says what its keys and the mouse do."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING

import glfw
import numpy as np

from codec.arrays import Doubles
from codec.camera import Camera
from player.playout.conductor import Conductor
from player.playout.timeline import FrameRecord
from player.render.gl import GlRenderer, Target
from player.render.gl.offscreen import BLACK, Colour
from player.render.renderer import Renderer, check_drawable
from player.render.steptimes import StepTimes
from player.view.mouse import view_of
from player.view.path import CameraPath

from .captionchoice import CaptionChoice
from .controls import Controls
from .glwindow import GlWindow
from .overlaygl import OverlayPainter
from .overlays import Overlays
from .playmeter import PlayMeter
from .posterscreen import PosterScreen

if TYPE_CHECKING:
    from player.sound.soundplayer import SoundPlayer

IDLE_S = 0.005
"""Seconds between two looks at the keyboard while there is nothing new to draw."""


Note = Callable[[FrameRecord, bool], None]
"""Called with each frame, and whether it was drawn: it is not if a newer one was due by then."""


def show_window(
    window: GlWindow,
    poster: PosterScreen,
    conductor: Conductor,
    path: CameraPath,
    renderers: list[Renderer],
    note: Note,
    background: Colour = BLACK,
    *,
    captions: CaptionChoice,
    sound: SoundPlayer | None = None,
) -> None:
    """Shows what plays until the window is closed: first the poster, at last the last picture.

    renderers: gets the one that draws, for its name and counters. sound: is heard from the camera.
    """
    manifest = conductor.source.manifest
    check_drawable(manifest)
    renderer = GlRenderer(manifest, Target.FLOAT16, window.context, window.version)
    renderers.append(renderer)
    with closing(renderer):
        conductor.smoothing.pictures_hz = window.pictures_hz
        conductor.attach(renderer)
        _Shown(window, poster, conductor, path, background, captions, sound).show(renderer, note)


class _Shown:
    """A play in a window, and the camera that a person moves."""

    def __init__(
        self,
        window: GlWindow,
        poster: PosterScreen,
        conductor: Conductor,
        path: CameraPath,
        background: Colour,
        captions: CaptionChoice,
        sound: SoundPlayer | None,
    ) -> None:
        source = conductor.source
        self._sound = sound
        self._window, self._poster = window, poster
        self._conductor, self._path, self._background = conductor, path, background
        self._view = view_of(source.manifest)
        self._controls = Controls(
            window.handle, conductor, self._view, path(source.frames.first).fy_px, captions, sound
        )
        self._painter = OverlayPainter(window.context)
        self._meter = PlayMeter()
        self._overlays = Overlays(self._meter, source.manifest.fps, captions)

    def show(self, renderer: GlRenderer, note: Note) -> None:
        """Returns when the window is closed."""
        frame, drawn, camera, glides = None, None, None, 0
        waiting: list[FrameRecord] = []
        last_s = time.monotonic()
        while not self._window.is_closed:
            glfw.poll_events()
            now_s = time.monotonic()
            # Only while the figures show does each step wait for the GPU.
            renderer.times = renderer.times or StepTimes() if self._controls.shows_info else None
            for record in self._conductor.poll():
                waiting.append(record)
                frame = record.frame
            glides += renderer.glide(self._conductor.share)
            if camera is not None:
                self._controls.fly(camera, now_s - last_s)
            last_s = now_s
            size = self._window.size_px
            pointed = partial(self._pointed, renderer, camera)
            overlays = self._overlays.now(self._conductor, self._controls, size, now_s, pointed)
            state = (frame, glides, self._controls.changes, size, overlays)
            if frame is None:
                self._poster.draw()
            if frame is None or state == drawn or not all(size):
                self._noted(waiting, None, note)  # a window without a size shows nothing
                time.sleep(IDLE_S)
                continue
            camera = self._view.applied(self._path(frame)).fitted(*size)
            renderer.present(frame, camera, self._window.context.screen, self._background)
            for placed in overlays:
                self._painter.paint(placed, self._window.context.screen, size)
            if renderer.times is not None:
                self._meter.took(renderer.times)
            self._window.swap()
            if self._sound is not None:
                self._sound.camera = camera
            drawn = state
            self._noted(waiting, frame, note)

    def _pointed(self, renderer: GlRenderer, camera: Camera | None) -> Doubles | None:
        """(3,) metres, world: what the pointer is on in the last picture, which `camera` saw."""
        if camera is None:
            return None
        at_px = self._controls.pointer_px((camera.width_px, camera.height_px))
        depth_m = renderer.depth_at(camera, *at_px) if at_px is not None else None
        if at_px is None or depth_m is None:
            return None
        return camera.unproject(*np.array([*at_px, depth_m], np.float64))

    def _noted(self, waiting: list[FrameRecord], frame: int | None, note: Note) -> None:
        """`frame` was drawn, of those that waited to be."""
        for record in waiting:
            note(record, record.frame == frame)
            self._meter.shown(record, record.frame == frame, time.monotonic())
        waiting.clear()
