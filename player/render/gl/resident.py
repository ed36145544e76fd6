"""Gaussians that stay on the GPU, ordered and drawn, in two ways behind one interface.

OpenGL 3.3 keeps the window in a texture, which the CPU orders, and mixes the newest changes between
two frames on the GPU. OpenGL 4.3 keeps it in a buffer, which compute shaders order; a slice uploads
the Gaussians that it changes, and no other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import moderngl
import numpy as np

from codec.arrays import Floats, Ints
from codec.camera import Camera
from codec.slice import Slice
from codec.stream.manifest import Manifest
from player.render.order import Order
from player.render.upload import (
    ENTERS,
    LEAVES,
    LEAVING_AT,
    MOVES,
    TEXTURE_WIDTH_PX,
    PackedLanes,
    PackedSlice,
    moves_of,
    pack_slice,
    spare_slots,
    texels_per_gaussian,
)

from .context import (
    Constants,
    GlError,
    Quads,
    Unlocked,
    compile_compute,
    compile_program,
    set_camera,
)
from .passes import ColourPass, DepthSort


@dataclass(frozen=True, slots=True)
class PackedRows:
    """A slice as its lane takes it.

    The last two words of a Gaussian, as int32, are its first frame and the slice's `serial`. What
    is kept has an older one, and what a shorter slice left behind it one that is older still.
    """

    lane: int
    serial: int  # rises from slice to slice, from 1 on
    birth: int
    rows: Ints | None  # (N,) rising, those of the lane that change; None: the lane is replaced
    words: Floats  # (N, 4 * texels); see texels_per_gaussian
    moves: Ints | None  # see moves_of


class RowPacker:
    """Packs slices; belongs to the thread that puts."""

    def __init__(self, swin_size: int, sh_degree: int, num_spare: int) -> None:
        """num_spare: slots for Gaussians that fade out."""
        self._swin_size, self._num_spare = swin_size, num_spare
        self._num_words = 4 * texels_per_gaussian(sh_degree)
        self._births: list[int | None] = [None] * swin_size
        self._serial = 0

    def pack(self, slice: Slice) -> PackedRows:
        """The slice, which fits a lane. Raises InvalidError if it changes what its lane lacks."""
        lane = slice.lane(self._swin_size)
        slice.check_follows(self._births[lane], self._swin_size)
        self._births[lane] = slice.birth
        self._serial += 1
        return self._packed(lane, slice)

    def _packed(self, lane: int, slice: Slice) -> PackedRows:
        words = np.zeros((len(slice.splats), self._num_words), np.float32)
        starts = np.empty(len(words), np.int32)
        pack_slice(slice, words, starts)
        times = words.view(np.int32)[:, -2:]
        times[:, 0], times[:, 1] = starts, self._serial
        moves = moves_of(slice, self._num_spare)
        return PackedRows(lane, self._serial, slice.birth, slice.rows, words, moves)

    def forget(self, lane: int) -> None:
        """Packed slices of `lane` may never be uploaded: only a whole slice can follow."""
        self._births[lane] = None


class Resident(Protocol):
    """The Gaussians of the window on the GPU. The context is current in every call."""

    @property
    def packer(self) -> RowPacker | PackedLanes:
        """Packs slices for `upload`; belongs to the thread that puts, and makes no GL call."""
        ...

    def upload(self, packed: Any) -> int:
        """Writes what the slice that `packer` packed changes; gives how many bytes."""
        ...

    def start_glide(self, frame: int) -> None:
        """Called when all slices up to `frame` are uploaded: the changes of the slice born at
        `frame` may be drawn on their way. Puts all other Gaussians at their final places."""
        ...

    def glide(self, share: float) -> int | None:
        """See Renderer.glide; gives how many bytes were written, None if nothing changed."""
        ...

    def sort(self, frame: int, camera: Camera) -> None:
        """Finds which Gaussians show in `frame`, farthest first."""
        ...

    def draw(self, camera: Camera, depths: bool = False) -> None:
        """Blends what was sorted last into the target, which is in use, as are the blend modes:
        colours, or depths in metres."""
        ...


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


GROUP = 256
"""Gaussians that one group of a shader looks at."""

MIN_NEAR_M = 1e-4
"""Depths are told apart from here on."""

_GAUSSIANS, _LANES, _ROWS, _CHANGED = range(4)  # bindings of the shaders
_BEFORE, _MOVES = 6, 7


class BufferResident:
    """Gaussians in a storage buffer, lane after lane; see Resident."""

    def __init__(self, context: moderngl.Context, manifest: Manifest) -> None:
        self._swin_size, slice_size = manifest.swin_size, manifest.slice_size
        texels = texels_per_gaussian(manifest.sh_degree)
        self._num_spare = spare_slots(slice_size)
        self.packer = RowPacker(self._swin_size, manifest.sh_degree, self._num_spare)
        self._slice_size = slice_size
        self._gaussian_bytes = 16 * texels
        self._spare_slot = self._swin_size * slice_size
        num_slots = self._spare_slot + self._num_spare
        _check_limits(context, manifest.num_gs, num_slots, self._gaussian_bytes)
        self._unlocked = Unlocked(context)
        self._manifest = manifest
        self._gaussians = context.buffer(reserve=self._gaussian_bytes * num_slots)
        self._gaussians.clear()
        # First frame, the frame after the last, number of the last whole slice and of the last one.
        self._lanes = np.zeros((self._swin_size + 1, 4), np.int32)
        self._lanes_buffer = context.buffer(self._lanes)
        constants = {
            "TEXELS": texels,
            "LANES": self._swin_size,
            "LANE_SLOTS": slice_size,
            "SLOTS": num_slots,
            "GROUP": GROUP,
            "SPARE_SLOT": self._spare_slot,
            "SH_DEGREE": manifest.sh_degree,
            "RESIDENT_BUFFER": 1,
        }
        self._rows, self._changed = context.buffer(reserve=4), context.buffer(reserve=16)
        self._before, self._moves = context.buffer(reserve=16), context.buffer(reserve=4)
        self._newest: PackedRows | None = None  # what was uploaded last
        self._gliding: PackedRows | None = None
        self._share = 1.0
        self._place = compile_compute(context, "place.glsl", constants)
        moves = {"MOVES": MOVES, "ENTERS": ENTERS, "LEAVING_AT": LEAVING_AT}
        self._mix = compile_compute(context, "mix.glsl", {**constants, **moves})
        self._sort = DepthSort(context, num_slots)
        self._cull = compile_compute(context, "cull.glsl", {**constants, **self._sort.constants})
        self._groups = -(-num_slots // GROUP)
        self._colours: ColourPass | None = None
        if manifest.sh_degree >= 2:
            self._colours = ColourPass(context, num_slots, manifest.least_near_m, constants, 430)
        self._quads = Quads(context, constants, 430, self._sort.order)

    def upload(self, packed: PackedRows) -> int:
        lane, first_slot = self._lanes[packed.lane], packed.lane * self._slice_size
        whole = packed.serial if packed.rows is None else lane[2]
        lane[:] = packed.birth, packed.birth + self._swin_size, whole, packed.serial
        self._write_lane(packed.lane)
        self._newest, self._gliding = packed, None
        if not len(packed.words):
            return 0
        if self._colours is not None:
            self._colours.forget(first_slot, self._slice_size)
        if packed.rows is None:
            self._gaussians.write(packed.words, offset=first_slot * self._gaussian_bytes)
            return packed.words.nbytes
        # Orphaned first: the slice before may still be read from them.
        for buffer, values in ((self._rows, packed.rows), (self._changed, packed.words)):
            buffer.orphan(values.nbytes)
            buffer.write(values)
        self._before.orphan(packed.words.nbytes)
        self._place["first_slot"], self._place["count"] = first_slot, len(packed.rows)
        self._gaussians.bind_to_storage_buffer(_GAUSSIANS)
        self._rows.bind_to_storage_buffer(_ROWS)
        self._changed.bind_to_storage_buffer(_CHANGED)
        self._before.bind_to_storage_buffer(_BEFORE)
        self._unlocked.compute(self._place, -(-len(packed.rows) // GROUP))
        num_bytes = packed.rows.nbytes + packed.words.nbytes
        if packed.moves is not None:
            self._moves.orphan(packed.moves.nbytes)
            self._moves.write(packed.moves)
            num_bytes += packed.moves.nbytes
        return num_bytes

    def _write_lane(self, lane: int) -> None:
        record = self._lanes[lane]
        self._lanes_buffer.write(record, offset=record.nbytes * lane)

    def start_glide(self, frame: int) -> None:
        newest, self._gliding, self._share = self._newest, None, 1.0
        if newest is not None and newest.birth == frame and newest.moves is not None:
            self._gliding = newest if len(newest.words) else None

    def glide(self, share: float) -> int | None:
        packed = self._gliding
        if packed is None or share == self._share:
            return None
        assert packed.rows is not None
        spare = self._lanes[self._swin_size]
        if (share < 1) != (self._share < 1):
            # Shows the spare slots of this slice, or none.
            spare[:] = packed.birth, packed.birth + (share < 1), packed.serial, packed.serial
            self._write_lane(self._swin_size)
            if self._colours is not None:
                self._colours.forget(self._spare_slot, self._num_spare)
        self._share = share
        self._mix["first_slot"] = packed.lane * self._slice_size
        self._mix["count"], self._mix["share"] = len(packed.rows), share
        self._mix["frame"], self._mix["serial"] = packed.birth, packed.serial
        for binding, buffer in (
            (_GAUSSIANS, self._gaussians), (_ROWS, self._rows), (_CHANGED, self._changed),
            (_BEFORE, self._before), (_MOVES, self._moves),
        ):  # fmt: skip
            buffer.bind_to_storage_buffer(binding)
        self._unlocked.compute(self._mix, -(-len(packed.rows) // GROUP))
        return 0

    def sort(self, frame: int, camera: Camera) -> None:
        near_m = self._manifest.near_of(camera)
        least_m = np.float32(max(near_m, MIN_NEAR_M))
        self._cull["frame"] = frame
        self._cull["newest_lane"] = frame % self._swin_size  # of a negative number GLSL has none
        self._cull["near_m"] = near_m
        self._cull["near_bits"] = int(least_m.view(np.uint32))
        set_camera(self._cull, camera)
        self._gaussians.bind_to_storage_buffer(_GAUSSIANS)
        if self._colours is not None:
            self._colours.update(camera)
        self._lanes_buffer.bind_to_storage_buffer(_LANES)
        self._sort.bind()
        self._unlocked.compute(self._cull, self._groups)
        self._sort.run(self._unlocked)

    def draw(self, camera: Camera, depths: bool = False) -> None:
        self._gaussians.bind_to_storage_buffer(_GAUSSIANS)
        if self._colours is not None:
            self._colours.bind()
        self._unlocked.draw_command(self._quads.seen(camera, depths), self._sort.command)


def _check_limits(
    context: moderngl.Context, num_gs: int, num_slots: int, gaussian_bytes: int
) -> None:
    info = context.info
    if info["GL_MAX_VERTEX_SHADER_STORAGE_BLOCKS"] < 1:
        raise GlError("this OpenGL 4.3 has no storage buffers in vertex shaders")
    limit_bytes = info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"]
    if num_slots * gaussian_bytes > limit_bytes:
        raise GlError(
            f"{num_gs} Gaussians need a buffer of {num_slots * gaussian_bytes} bytes; "
            f"this OpenGL allows {limit_bytes}"
        )
    limit_groups = info["GL_MAX_COMPUTE_WORK_GROUP_COUNT"][0]
    if -(-num_slots // GROUP) > limit_groups:
        raise GlError(f"this OpenGL can sort {limit_groups * GROUP} Gaussians, not {num_slots}")
