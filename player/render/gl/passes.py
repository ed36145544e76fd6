"""Passes of OpenGL before Gaussians are drawn: colours from harmonics of degree 2 and 3, once
for a place of the camera, and a sort by depth.

Rule: the sort is stable, so equal depths keep their order and pictures do not flicker. Each pass
orders by one digit. A group counts the digits in its block of keys; prefix sums over all groups say
where each group puts the keys of each digit; a thread puts those of its own run of keys there one
after another. Nothing depends on which thread is first.
"""

from __future__ import annotations

import moderngl
import numpy as np

from codec.camera import Camera
from player.render.project import COLOUR_TURN_RAD
from player.render.upload import COLOUR_COLUMNS

from .context import Constants, Unlocked, compile_compute, compile_program


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


DIGIT_BITS = 4
PASSES = 7
KEY_BITS = DIGIT_BITS * PASSES
"""Bits of a key: 28 hold the order of float32 depths over 32 powers of two."""

ABSENT = 0xFFFFFFFF
"""The key of what is to be left out."""

THREADS = 128
RUN = 8
"""Keys that one thread counts and puts."""
BLOCK = THREADS * RUN
SCAN_THREADS = 256

# Bindings of the shaders; 0 and 1 are those of the Gaussians.
_COMMAND, _TALLIES, _KEYS, _SLOTS, _SORTED_KEYS, _SORTED_SLOTS = range(2, 8)


class DepthSort:
    """Sorts keys, and slots with them; the context is current in every call."""

    def __init__(self, context: moderngl.Context, num_slots: int) -> None:
        self._groups = -(-num_slots // BLOCK)
        self.keys = context.buffer(reserve=4 * num_slots)
        """Below 2 ** KEY_BITS, or ABSENT. A sort overwrites them."""
        self.command = context.buffer(np.array([4, 0, 0, 0], np.uint32))
        """Four vertices, how many keys were not absent, 0, 0: an indirect draw."""
        self._tallies = context.buffer(reserve=4 * self._groups << DIGIT_BITS)
        other = context.buffer(reserve=4 * num_slots)
        self.slots, other_slots = (context.buffer(reserve=4 * num_slots) for _ in range(2))
        """Numbers of the Gaussians that the keys belong to. A sort overwrites them."""
        self._ways = (
            (self.keys, self.slots, other, other_slots),
            (other, other_slots, self.keys, self.slots),
        )
        self.order = self._ways[(PASSES - 1) % 2][3]
        """Slots in the order of their keys."""
        self.constants: Constants = {"KEY_BITS": KEY_BITS, "ABSENT": f"{ABSENT:#x}u"}
        """Constants of a shader that writes keys."""
        constants = {
            **self.constants,
            "SLOTS": num_slots,
            "DIGIT_BITS": DIGIT_BITS,
            "THREADS": THREADS,
            "RUN": RUN,
            "SCAN_THREADS": SCAN_THREADS,
        }
        self._count = compile_compute(context, "count.glsl", constants)
        self._scan = compile_compute(context, "scan.glsl", constants)
        self._scatter = compile_compute(context, "scatter.glsl", constants)

    def bind(self) -> None:
        """Makes `keys` and `slots` what the next shader writes to."""
        self.keys.bind_to_storage_buffer(_KEYS)
        self.slots.bind_to_storage_buffer(_SLOTS)

    def run(self, unlocked: Unlocked) -> None:
        """Sorts; `order` and `command` say how."""
        self.command.bind_to_storage_buffer(_COMMAND)
        self._tallies.bind_to_storage_buffer(_TALLIES)
        for digit in range(PASSES):
            for binding, buffer in enumerate(self._ways[digit % 2], _KEYS):
                buffer.bind_to_storage_buffer(binding)
            for shader, groups in (
                (self._count, self._groups), (self._scan, 1), (self._scatter, self._groups),
            ):  # fmt: skip
                shader["digit"] = digit
                unlocked.compute(shader, groups)
