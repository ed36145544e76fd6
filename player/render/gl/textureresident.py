"""OpenGL 3.3: the window stays in one texture, and the CPU orders it."""

from __future__ import annotations

import moderngl
import numpy as np

from codec.arrays import Ints
from codec.camera import Camera
from codec.stream.manifest import Manifest

from ..moves import LEAVES, LEAVING_AT, spare_slots
from ..order import Order
from ..pack import TEXTURE_WIDTH_PX, texels_per_gaussian
from ..patch import PackedLanes, PackedSlice
from .colourpass import ColourPass
from .glcontext import GlError, Unlocked
from .programs import Quads
from .texelmix import Mixture, TexelMix


class TextureResident:
    """Gaussians in rows of a texture; see Resident."""

    def __init__(self, context: moderngl.Context, manifest: Manifest) -> None:
        texels = texels_per_gaussian(manifest.sh_degree)
        columns = TEXTURE_WIDTH_PX // texels
        self.packer = PackedLanes(
            manifest.swin_size, manifest.slice_size, manifest.sh_degree, columns
        )
        lane_slots = self.packer.lane_rows * columns
        self._num_spare = spare_slots(manifest.slice_size)
        self._spare_slot = manifest.swin_size * lane_slots
        height_px = self.packer.lane_rows * manifest.swin_size + -(-self._num_spare // columns)
        limit_px = context.info["GL_MAX_TEXTURE_SIZE"]
        if max(height_px, TEXTURE_WIDTH_PX) > limit_px:
            raise GlError(
                f"{manifest.num_gs} Gaussians need a texture of {TEXTURE_WIDTH_PX}x{height_px}; "
                f"this OpenGL allows {limit_px}"
            )
        self._manifest = manifest
        self._order = Order(manifest.swin_size, lane_slots, self._num_spare)
        self._shown: Ints = np.empty(0, np.int32)
        self._unlocked = Unlocked(context)
        self._texture = context.texture((columns * texels, height_px), 4, dtype="u4")
        self._texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        constants = {
            "TEXELS": texels,
            "COLUMNS": columns,
            "SH_DEGREE": manifest.sh_degree,
        }
        self._mix = TexelMix(context, self._texture, constants)
        self._colours: ColourPass | None = None
        if manifest.sh_degree >= 2:
            num_slots = self._spare_slot + self._num_spare
            self._colours = ColourPass(context, num_slots, manifest.least_near_m, constants, 330)
        self._lane_slots = lane_slots
        self._newest: PackedSlice | None = None  # what was uploaded last, if it moves anything
        self._gliding: PackedSlice | None = None
        self._share = 1.0
        self._slots = context.buffer(reserve=4 * (self._spare_slot + self._num_spare))
        self._quads = Quads(context, constants, 330, self._slots)

    def start_glide(self, frame: int) -> None:
        newest = self._newest
        self._gliding = newest if newest is not None and newest.birth == frame else None
        self._share = 1.0

    def glide(self, share: float) -> int | None:
        packed = self._gliding
        if packed is None or share == self._share:
            return None
        assert packed.motion is not None
        assert packed.rows is not None
        if self._colours is not None and (share < 1) != (self._share < 1):
            self._colours.forget(self._spare_slot, self._num_spare)
        self._share = share
        self._mix.put(share)
        motion = packed.motion
        starts = packed.starts[np.searchsorted(packed.rows, motion.rows)]
        means = motion.means_at(share)
        self._order.update_lane(packed.lane, packed.expire, means, starts, motion.rows)
        self._order.spare = motion.leaving.means[: self._num_spare if share < 1 else 0]
        return 0

    def upload(self, packed: PackedSlice) -> int:
        self._order.update_lane(
            packed.lane, packed.expire, packed.means, packed.starts, packed.rows
        )
        mixture = self._mixture(packed)
        num_bytes = packed.num_bytes
        if mixture is not None:
            num_bytes += self._mix.begin(mixture)
        for patch in packed.patches:
            height_px, width_px, _ = patch.texels.shape
            self._texture.write(
                patch.texels, viewport=(patch.x_px, patch.y_px, width_px, height_px)
            )
        self._newest = None
        if mixture is not None:
            self._mix.end()
            self._newest = packed
        if self._colours is not None:
            self._colours.forget(packed.lane * self._lane_slots, self._lane_slots)
        return num_bytes

    def _mixture(self, packed: PackedSlice) -> Mixture | None:
        """The changes of the slice that are drawn on their way; None if there are none."""
        rows, moves = packed.rows, packed.moves
        if rows is None or moves is None or not moves.any():
            return None
        at = np.flatnonzero(moves)
        slots, moves = rows[at] + np.int32(packed.lane * self._lane_slots), moves[at]
        comes, spare = moves & ((1 << LEAVING_AT) - 1), moves >> LEAVING_AT
        here, leaves = np.flatnonzero(comes), np.flatnonzero(spare)
        kinds = np.concatenate([comes[here], np.full(len(leaves), LEAVES)])
        targets = np.concatenate([slots[here], self._spare_slot - 1 + spare[leaves]])
        items = np.stack([targets, kinds, np.concatenate([here, leaves])], axis=1)
        return Mixture(slots, items.astype(np.int32))

    def sort(self, frame: int, camera: Camera) -> None:
        if self._colours is not None:
            self._texture.use(0)
            self._colours.update(camera)
        near_m = self._manifest.near_of(camera)
        self._shown = self._order.far_first(frame, camera.w2c, near_m)

    def draw(self, camera: Camera, depths: bool = False) -> None:
        if not len(self._shown):
            return
        # Orphaned first: the frame before may still be read from it.
        self._slots.orphan()
        self._slots.write(self._shown)
        self._texture.use(0)
        if self._colours is not None:
            self._colours.bind()
        self._unlocked.draw_quads(self._quads.seen(camera, depths), len(self._shown))
