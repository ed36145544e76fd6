"""OpenGL 4.3: the window stays in one buffer, and compute shaders order it."""

from __future__ import annotations

import moderngl
import numpy as np

from codec.camera import Camera
from codec.stream.manifest import Manifest

from ..moves import ENTERS, LEAVING_AT, MOVES, spare_slots
from ..pack import texels_per_gaussian
from .colourpass import ColourPass
from .depthsort import DepthSort
from .glcontext import GlError, Unlocked
from .programs import Quads, compile_compute, set_camera
from .rowpacker import PackedRows, RowPacker

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
