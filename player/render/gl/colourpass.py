"""Colours from harmonics of degree 2 and 3, evaluated on the GPU once for a place of the camera."""

from __future__ import annotations

import moderngl
import numpy as np

from codec.camera import Camera

from ..pack import COLOUR_COLUMNS
from ..recipe import COLOUR_TURN_RAD
from .glcontext import Unlocked
from .programs import Constants, compile_program


class ColourPass:
    """A texture with the colour of each slot, for the splat shader; texture unit 1.

    All are evaluated from one place, which follows the camera when that has moved so far that the
    direction to what is as near as the near plane may have turned by COLOUR_TURN_RAD.
    """

    def __init__(
        self,
        context: moderngl.Context,
        num_slots: int,
        near_m: float,
        constants: Constants,
        version: int,
    ) -> None:
        """constants: of the shaders, as the splat shader has them."""
        self._context, self._unlocked = context, Unlocked(context)
        self._num_slots, self._reach_m = num_slots, COLOUR_TURN_RAD * near_m
        size = (COLOUR_COLUMNS, -(-num_slots // COLOUR_COLUMNS))
        self._texture = context.texture(size, 4, dtype="u4")
        self._texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._target = context.framebuffer([self._texture])
        self._program = compile_program(context, "colours.glsl", constants, version)
        self._program["size_px"] = size
        self._points = context.vertex_array(self._program, [])
        self._seen_from = np.full(3, np.inf)
        self._stale: set[tuple[int, int]] = set()

    def forget(self, first_slot: int, count: int) -> None:
        """The Gaussians of these slots, a lane, are others now."""
        self._stale.add((first_slot, count))

    def update(self, camera: Camera) -> None:
        """Evaluates what is out of date for `camera`; the Gaussians are bound."""
        if not np.linalg.norm(camera.position - self._seen_from) <= self._reach_m:
            self._seen_from = camera.position
            self._stale = {(0, self._num_slots)}
        if not self._stale:
            return
        self._target.use()
        self._context.enable_only(moderngl.NOTHING)
        self._program["position"] = tuple(self._seen_from)
        for first_slot, count in self._stale:
            self._unlocked.draw_points(self._points, first_slot, count)
        self._stale.clear()

    def bind(self) -> None:
        """For the splat shader, whose `colours` is texture unit 1."""
        self._texture.use(1)
