"""OpenGL 3.3: the window stays in one texture, and the CPU orders it."""

from __future__ import annotations

import moderngl
import numpy as np
import numpy.typing as npt

from codec.camera import Camera
from codec.stream.manifest import Manifest

from ..order import Order
from ..pack import TEXTURE_WIDTH_PX, texels_per_gaussian
from ..patch import PackedLanes, PackedSlice
from .colourpass import ColourPass
from .glcontext import GlError, Unlocked
from .programs import compile_program, set_camera


class TextureResident:
    """Gaussians in rows of a texture; see Resident."""

    def __init__(self, context: moderngl.Context, manifest: Manifest) -> None:
        texels = texels_per_gaussian(manifest.sh_degree)
        columns = TEXTURE_WIDTH_PX // texels
        self.packer = PackedLanes(
            manifest.swin_size, manifest.slice_size, manifest.sh_degree, columns
        )
        lane_slots = self.packer.lane_rows * columns
        height_px = self.packer.lane_rows * manifest.swin_size
        limit_px = context.info["GL_MAX_TEXTURE_SIZE"]
        if max(height_px, TEXTURE_WIDTH_PX) > limit_px:
            raise GlError(
                f"{manifest.num_gs} Gaussians need a texture of {TEXTURE_WIDTH_PX}x{height_px}; "
                f"this OpenGL allows {limit_px}"
            )
        self._manifest = manifest
        self._order = Order(manifest.swin_size, lane_slots)
        self._shown: npt.NDArray[np.int32] = np.empty(0, np.int32)
        self._unlocked = Unlocked(context)
        self._texture = context.texture((columns * texels, height_px), 4, dtype="u4")
        self._texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        constants = {
            "TEXELS": texels,
            "COLUMNS": columns,
            "SH_DEGREE": manifest.sh_degree,
        }
        self._program = compile_program(context, "splat.glsl", constants)
        self._colours: ColourPass | None = None
        if manifest.sh_degree >= 2:
            num_slots = manifest.swin_size * lane_slots
            self._colours = ColourPass(context, num_slots, manifest.least_near_m, constants, 330)
            self._program["colours"] = 1
        self._lane_slots = lane_slots
        self._slots = context.buffer(reserve=4 * manifest.swin_size * lane_slots)
        self._quads = context.vertex_array(self._program, [(self._slots, "1u/i", "slot")])

    def upload(self, packed: PackedSlice) -> int:
        self._order.update_lane(
            packed.lane, packed.expire, packed.means, packed.starts, packed.rows
        )
        for patch in packed.patches:
            height_px, width_px, _ = patch.texels.shape
            self._texture.write(
                patch.texels, viewport=(patch.x_px, patch.y_px, width_px, height_px)
            )
        if self._colours is not None:
            self._colours.forget(packed.lane * self._lane_slots, self._lane_slots)
        return packed.num_bytes

    def sort(self, frame: int, camera: Camera) -> None:
        if self._colours is not None:
            self._texture.use(0)
            self._colours.update(camera)
        near_m = self._manifest.near_of(camera)
        self._shown = self._order.far_first(frame, camera.w2c, near_m)

    def draw(self, camera: Camera) -> None:
        if not len(self._shown):
            return
        # Orphaned first: the frame before may still be read from it.
        self._slots.orphan()
        self._slots.write(self._shown)
        set_camera(self._program, camera)
        self._texture.use(0)
        if self._colours is not None:
            self._colours.bind()
        self._unlocked.draw_quads(self._quads, len(self._shown))
