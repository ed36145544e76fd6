"""The compressed PLY of SuperSplat, in: 16 bytes a Gaussian and bounds for each 256 of them.

Layout (playcanvas/engine, `gsplat-compressed-data.js`), a PLY file with the elements

    chunk    ceil(N / 256) rows: float min_x .. max_z, min_scale_x .. max_scale_z (of ln s) and, in
             newer files, min_r .. max_b; without these colours lie in 0..1
    vertex   N rows of four uint, highest bits first:
             packed_position  x 11, y 10, z 11 bits between the chunk's bounds
             packed_rotation  2 bits: which of w, x, y, z is largest and left out; the other three
                              in order, 10 bits each, as (v / 1023 - 1/2) * sqrt(2)
             packed_scale     x 11, y 10, z 11 bits between the chunk's bounds
             packed_color     red, green, blue between the chunk's bounds, opacity 0..1; 8 bits each
    sh       optional, N rows of 9, 24 or 45 uchar f_rest_i, channel-major: v * 8 / 255 - 4

Frame RDF as in the PLY; colour is 0.5 + SH_C0 f_dc.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from codec.arrays import Doubles
from codec.errors import CorruptError, UnsupportedError
from codec.splats import SH_C0, Splats

from .levels import byte_logits, restore_largest
from .limits import MAX_GAUSSIANS, Decoded, check_count
from .notes import tell_model
from .ply import REST_COUNTS, rest_names, trained_as
from .plyheader import PlyElement, PlyHeader, read_ply_header

CHUNK_GAUSSIANS = 256
AXES, SCALES, COLOURS = ("x", "y", "z"), ("scale_x", "scale_y", "scale_z"), ("r", "g", "b")
PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")

Words = npt.NDArray[np.uint32]


def is_compressed(header: PlyHeader) -> bool:
    """Whether a PLY with this header is of this layout."""
    vertex = header.tables.get("vertex")
    return "chunk" in header.tables and vertex is not None and PACKED[0] in vertex.properties


def _unpack(words: Words, *widths: int) -> Doubles:
    """(N, len(widths)) numbers 0..1 of bit fields, highest bits first."""
    fields = np.empty((len(words), len(widths)))
    shift = sum(widths)
    for i, width in enumerate(widths):
        shift -= width
        top = (1 << width) - 1
        fields[:, i] = (words >> np.uint32(shift) & np.uint32(top)) / top
    return fields


def _bounds(chunks: npt.NDArray[np.void], count: int, suffixes: tuple[str, ...]) -> Doubles:
    """(2, N, 3) the lower and upper bounds of each Gaussian's chunk."""
    corners = np.stack(
        [
            np.stack([chunks[f"{end}_{suffix}"].astype(np.float64) for suffix in suffixes], 1)
            for end in ("min", "max")
        ]
    )
    repeated: Doubles = np.repeat(corners, CHUNK_GAUSSIANS, axis=1)[:, :count]
    return repeated


def _between(bounds: Doubles, shares: Doubles) -> Doubles:
    between: Doubles = bounds[0] * (1 - shares) + bounds[1] * shares
    return between


def _rest_names(sh: PlyElement | None, count: int) -> list[str]:
    """The properties of `sh`, in order; none without it."""
    if sh is None:
        return []
    names = rest_names(sh.properties)
    if sh.count != count or any(sh.dtype[name] != np.uint8 for name in names):
        raise CorruptError(f"PLY: element sh is not {count} rows of uchar")
    return names


@dataclass(frozen=True, slots=True)
class CompressedLayout:
    """Where in a compressed PLY the Gaussians are."""

    chunk: PlyElement
    vertex: PlyElement
    sh: PlyElement | None
    rest: list[str]
    """The properties of `sh`, in order."""
    model: str
    """How the Gaussians were trained; see `tell_model`."""


def compressed_layout(
    head: bytes, file_bytes: int, max_gaussians: int = MAX_GAUSSIANS
) -> CompressedLayout:
    """The layout of the Gaussians, by the header of a compressed PLY of `file_bytes` in all.

    Raises CorruptError, or UnsupportedError, also for more than `max_gaussians`.
    """
    header = read_ply_header(head)
    header.check_rows()
    elements = header.tables
    if not is_compressed(header):
        raise UnsupportedError(
            "PLY: not compressed; a compressed PLY has elements chunk and packed_position"
        )
    chunk, vertex, sh = elements["chunk"], elements["vertex"], elements.get("sh")
    count = check_count("PLY", vertex.count, max_gaussians)
    if chunk.count != -(-count // CHUNK_GAUSSIANS):
        raise CorruptError(f"PLY: {chunk.count} chunks for {count} Gaussians")
    wanted = [f"{end}_{suffix}" for end in ("min", "max") for suffix in (*AXES, *SCALES)]
    missing = [name for name in wanted if name not in chunk.properties]
    missing += [name for name in PACKED if name not in vertex.properties]
    if missing:
        raise CorruptError(f"PLY: no property {', '.join(missing[:4])}")
    if any(vertex.dtype[name] != np.uint32 for name in PACKED):
        raise CorruptError("PLY: a packed property is not uint")
    rest = _rest_names(sh, count)
    for element in (chunk, vertex, *([] if sh is None else [sh])):
        element.check_size(file_bytes)
    return CompressedLayout(chunk, vertex, sh, rest, trained_as(header))


def decode_compressed_ply(data: bytes, max_gaussians: int = MAX_GAUSSIANS) -> Splats:
    """The Gaussians of a compressed PLY.

    Raises CorruptError, or UnsupportedError, also for more than `max_gaussians`.
    """
    layout = compressed_layout(data, len(data), max_gaussians)
    tell_model(layout.model)
    chunks, packed = layout.chunk.rows(data), layout.vertex.rows(data)
    made = Decoded.empty(layout.vertex.count, REST_COUNTS[len(layout.rest)])
    tints = [f"{end}_{colour}" for end in ("min", "max") for colour in COLOURS]
    tinted = all(name in layout.chunk.properties for name in tints)
    for block in made.blocks():
        rows, size = packed[block], block.stop - block.start
        bounds = chunks[block.start // CHUNK_GAUSSIANS : -(-block.stop // CHUNK_GAUSSIANS)]
        position, rotation, scale, colour = (rows[name].astype(np.uint32) for name in PACKED)
        rgb = _unpack(colour, 8, 8, 8, 8)[:, :3]
        three = (_unpack(rotation, 2, 10, 10, 10)[:, 1:] - 0.5) * np.sqrt(2.0)
        with np.errstate(all="ignore"):  # infinities and NaN are refused below
            if tinted:
                rgb = _between(_bounds(bounds, size, COLOURS), rgb)
            made.means[block] = _between(_bounds(bounds, size, AXES), _unpack(position, 11, 10, 11))
            made.log_scales[block] = _between(
                _bounds(bounds, size, SCALES), _unpack(scale, 11, 10, 11)
            )
            made.sh[block, 0] = (rgb - 0.5) / SH_C0
            made.quats[block] = restore_largest(three, rotation >> np.uint32(30))
        made.logit_opacities[block] = byte_logits((colour & np.uint32(255)).astype(np.uint8))
    if layout.sh is not None:
        harmonics = layout.sh.rows(data)
        for i, name in enumerate(layout.rest):
            channel, coefficient = divmod(i, len(layout.rest) // 3)
            levels = harmonics[name] * np.float32(8 / 255) - np.float32(4)
            made.sh[:, 1 + coefficient, channel] = levels
    return made.checked("PLY")
