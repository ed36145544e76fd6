"""OpenGL 3.3: the changes of the newest slice, interpolated on the GPU between two frames."""

from __future__ import annotations

from dataclasses import dataclass

import moderngl

from codec.arrays import Ints

from ..moves import ENTERS, LEAVES
from .glcontext import Unlocked
from .programs import Constants, compile_program

SIDE_PX = 2048
"""Width of the textures with Gaussians that are set aside."""


@dataclass(frozen=True, slots=True)
class Mixture:
    """M slots that change, and where they are written to between two frames."""

    slots: Ints  # (M,)
    items: Ints  # (N, 3) slot to write to, MOVES, ENTERS or LEAVES, and place in `slots`

    @property
    def num_bytes(self) -> int:
        return self.slots.nbytes + self.items.nbytes


class TexelMix:
    """Sets Gaussians of the resident texture aside, before and after a slice changes them, and
    writes them there at any share of the way. The context is current in every call."""

    def __init__(
        self, context: moderngl.Context, resident: moderngl.Texture, constants: Constants
    ) -> None:
        self._context, self._unlocked = context, Unlocked(context)
        self._resident = resident
        self._target = context.framebuffer([resident])
        self._texels = int(constants["TEXELS"])
        more: Constants = {**constants, "SIDE_PX": SIDE_PX, "ENTERS": ENTERS, "LEAVES": LEAVES}
        self._save = compile_program(context, "texelmix.glsl", more)
        self._mix = compile_program(context, "texelmix.glsl", {**more, "MIXES": 1})
        self._mix["before"], self._mix["after"] = 0, 1
        self._mix["size_px"] = resident.size
        self._slots, self._items = (context.buffer(reserve=16) for _ in range(2))
        self._saved = context.vertex_array(self._save, [(self._slots, "1u/i", "item")])
        self._mixed = context.vertex_array(self._mix, [(self._items, "3u/i", "item")])
        self._mixture: Mixture | None = None
        self._grow(1)

    def _grow(self, height_px: int) -> None:
        self._height_px = height_px
        self._aside = [self._context.texture((SIDE_PX, height_px), 4, dtype="u4") for _ in range(2)]
        for texture in self._aside:
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._targets = [self._context.framebuffer([texture]) for texture in self._aside]
        self._save["size_px"] = (SIDE_PX, height_px)

    def begin(self, mixture: Mixture) -> int:
        """Sets aside what a slice is about to change; gives how many bytes were written."""
        self._mixture = mixture
        height_px = -(-len(mixture.slots) * self._texels // SIDE_PX)
        if height_px > self._height_px:
            self._grow(height_px)
        for buffer, values in ((self._slots, mixture.slots), (self._items, mixture.items)):
            buffer.orphan(values.nbytes)
            buffer.write(values)
        self._set_aside(0)
        return mixture.num_bytes

    def end(self) -> None:
        """Sets aside what the slice has changed."""
        self._set_aside(1)

    def _set_aside(self, which: int) -> None:
        assert self._mixture is not None
        self._targets[which].use()
        self._context.enable_only(moderngl.NOTHING)
        self._resident.use(0)
        self._saved.render(
            moderngl.POINTS, vertices=self._texels, instances=len(self._mixture.slots)
        )

    def put(self, share: float) -> None:
        """Writes what is set aside to the resident texture at `share` of its way."""
        assert self._mixture is not None
        self._target.use()
        self._context.enable_only(moderngl.NOTHING)
        for unit, texture in enumerate(self._aside):
            texture.use(unit)
        self._mix["share"] = share
        self._mixed.render(
            moderngl.POINTS, vertices=self._texels, instances=len(self._mixture.items)
        )
