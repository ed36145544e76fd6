"""SPZ (nianticlabs/spz): versions 1 to 4 in, 2 to 4 out; 16 bytes a Gaussian at degree 0.

Layout, little-endian. Versions 1 to 3 are one gzip stream of a header of 16 bytes, the arrays and
the extensions; version 4 is a header of 32 bytes, the extensions, a table of contents and one zstd
frame for each array that is not empty.

    header   u32 magic "NGSP", u32 version, u32 N, u8 SH degree, u8 fractional bits,
             u8 flags (1 = trained with opacity compensation, 2 = extensions), u8 zero;
             in version 4 that u8 is the number of arrays, then u32 offset of the table, 12 zeros
    table    for each array: u64 compressed bytes, u64 raw bytes
    arrays   positions  version 1: f16 x 3; later: i24 x 3, fixed point with the fractional bits
             opacities  u8, of 255
             colours    u8 x 3: f_dc * 0.15 * 255 + 127.5
             scales     u8 x 3: (ln s + 10) * 16
             rotations  to version 2: u8 x 3, x y z as (q + 1) * 127.5, w >= 0 follows;
                        later: u32, 2 bits which of x, y, z, w is largest and left out, then the
                        other three in order: sign and 9 bits of |q| * sqrt(2) * 511
             harmonics  u8 x 3 (K - 1), coefficient after coefficient, RGB: 128 (1 + c)
    extension  u32 kind, u32 bytes, content; of kind 0xADBE0003: u32 axes, one of AXES

Convention: the file's frame is RUB (x right, y up, z back) unless an extension names another, ours
is the PLY's RDF (x right, y down, z forward). A file of RUB is ours after half a turn about x. What
is written names its axes: splat-transform from version 3 on writes and reads RDF without a word.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import zstandard

from codec.arrays import Bytes, Floats
from codec.console import listed
from codec.errors import CorruptError, InvalidError, UnsupportedError
from codec.similarity import Similarity, half_turned, mirrored
from codec.splats import MAX_SH_DEGREE, Splats, sh_count

from .bounds import (
    MAX_GAUSSIANS,
    Decoded,
    byte_logits,
    check_count,
    check_ratio,
    clipped_bytes,
    opacity_bytes,
    restore_largest,
    split_largest,
    unit_quats,
)
from .notes import ANTIALIASED, notes, tell_model

MAGIC = 0x5053474E
HEADER = struct.Struct("<IIIBBBB")
HEADER_V4 = struct.Struct("<IIIBBBBI12s")
ENTRY = struct.Struct("<QQ")
assert (HEADER.size, HEADER_V4.size) == (16, 32)

FLAG_ANTIALIAS, FLAG_EXTENSIONS = 1, 2
RECORD = struct.Struct("<II")
AXES_KIND = 0xADBE0003
RUB = 4
AXES = [
    *("LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF"),
    *("LFD", "RFD", "LFU", "RFU", "LBD", "RBD", "LBU", "RBU"),
]
"""Names of the axes 1, 2, ...: left or right, down or up, back or front."""
AXES_RECORD = RECORD.pack(AXES_KIND, 4) + struct.pack("<I", RUB)
MAX_NAMED_KINDS = 4
RAW_HINT = (
    "an SPZ that names no axes is read as right, up, back; splat-transform 3 leaves y down: if the "
    "model is on its head, turn it: `swings-stream edit transform STREAM OUT --turn 180 0 0`"
)
MAX_FRACTIONAL_BITS = 23
"""Position bits after the point: the sign takes one of 24."""
DEFAULT_FRACTIONAL_BITS = 12
"""The scale of other writers: steps of 0.24 mm, up to 2048 m from the origin."""
COLOUR_SCALE = 0.15
ZSTD_LEVEL = 12
GZIP_LEVEL = 9
GZIP_VERSIONS = (1, 2, 3)
EXTENSION_BYTES = 1 << 20
"""Bytes tolerated after the arrays of versions 1 to 3, for extensions."""


class SpzVersion(IntEnum):
    """Versions that can be written: 2 and 3 are read by most programs, 4 is a little smaller."""

    V2 = 2
    V3 = 3
    V4 = 4


@dataclass(frozen=True, slots=True)
class SpzHeader:
    """The fields with which every version begins."""

    version: int
    count: int
    sh_degree: int
    fractional_bits: int
    flags: int

    @property
    def array_bytes(self) -> tuple[int, ...]:
        """Sizes of the arrays that are there, in order."""
        return tuple(self.count * width for width in self.widths if width)

    @property
    def widths(self) -> tuple[int, ...]:
        """Bytes of a Gaussian in each of the six arrays."""
        position = 6 if self.version == 1 else 9
        rotation = 3 if self.version <= 2 else 4
        return position, 1, 3, 3, rotation, 3 * (sh_count(self.sh_degree) - 1)


def _in_our_axes(splats: Splats, axes: int) -> Splats:
    """`splats` of a file of `axes`, from 1 on, in RDF; exactly, but for harmonics of axes whose
    second one is front or back."""
    name = AXES[axes - 1]
    signs = np.array([1 if letter in "RDF" else -1 for letter in name], np.float32)
    if name[1] in "DU":
        return mirrored(splats, signs)
    # To right, front, up; from there a quarter of a turn about x leads to right, down, front.
    quarter = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    upright = mirrored(splats, signs * np.array([1, 1, -1], np.float32))
    return Similarity(1.0, quarter, np.zeros(3)).moved(upright)


def _axes_of(records: memoryview) -> int | None:
    """The axes that the extensions of a file name, if any. Other extensions go into the notes.

    Raises UnsupportedError for axes that are not known.
    """
    axes, others, at = None, list[str](), 0
    while at < len(records):
        kind, size = RECORD.unpack_from(records, at) if at + RECORD.size <= len(records) else (0, 0)
        content = records[at + RECORD.size : at + RECORD.size + size]
        if not kind or len(content) < size:
            others.append(f"{len(records) - at} bytes that are no extension")
            break
        at += RECORD.size + size
        if kind == AXES_KIND and size >= 4:
            axes = int.from_bytes(content[:4], "little") or None  # 0 is "unspecified"
        else:
            others.append(f"0x{kind:08X} ({size} bytes)")
    if axes is not None and axes > len(AXES):
        raise UnsupportedError(f"SPZ: axes {axes}; this program knows 1 to {len(AXES)}")
    if others:
        named = listed(others, MAX_NAMED_KINDS)
        notes().say(f"extensions that are not read, so it may look otherwise: {named}")
    return axes


def _header(
    data: bytes, versions: tuple[int, ...], file_bytes: int, max_gaussians: int
) -> SpzHeader:
    """The header of a file of `file_bytes`, checked."""
    magic, version, count, sh_degree, fractional_bits, flags, _ = HEADER.unpack_from(data)
    if magic != MAGIC:
        raise CorruptError("SPZ: does not start with NGSP")
    if version not in versions:
        names = " or ".join(map(str, versions))
        raise UnsupportedError(f"SPZ: version {version}; in this container it must be {names}")
    if sh_degree > MAX_SH_DEGREE:
        raise UnsupportedError(f"SPZ: SH degree {sh_degree}, at most {MAX_SH_DEGREE}")
    if fractional_bits > MAX_FRACTIONAL_BITS:
        raise CorruptError(f"SPZ: {fractional_bits} fractional bits of 24")
    check_count("SPZ", count, max_gaussians)
    header = SpzHeader(version, count, sh_degree, fractional_bits, flags)
    check_ratio("SPZ", sum(header.array_bytes), file_bytes)
    return header


def _gunzip(stream: zlib._Decompress, data: bytes, limit_bytes: int) -> bytes:
    try:
        return stream.decompress(data, limit_bytes)
    except zlib.error as error:
        raise CorruptError(f"SPZ: {error}") from error


def _is_gzip(data: bytes) -> bool:
    return data.startswith(b"\x1f\x8b")


def spz_header(head: bytes, file_bytes: int, max_gaussians: int = MAX_GAUSSIANS) -> SpzHeader:
    """The header of an SPZ file of `file_bytes` that begins with `head`.

    Raises CorruptError, or UnsupportedError, also for more than `max_gaussians`.
    """
    is_gzip = _is_gzip(head)
    if is_gzip:
        head = _gunzip(zlib.decompressobj(wbits=31), head, HEADER.size)
    size_bytes = HEADER.size if is_gzip else HEADER_V4.size
    if len(head) < size_bytes:
        raise CorruptError(f"SPZ: ends inside its header of {size_bytes} bytes")
    return _header(head, GZIP_VERSIONS if is_gzip else (4,), file_bytes, max_gaussians)


def _gzip_arrays(data: bytes, header: SpzHeader) -> tuple[list[memoryview], memoryview]:
    """The arrays of versions 1 to 3, and what follows on them."""
    stream = zlib.decompressobj(wbits=31)
    wanted = sum(header.array_bytes)
    body = memoryview(_gunzip(stream, data, HEADER.size + wanted + EXTENSION_BYTES))[HEADER.size :]
    if len(body) < wanted or not stream.eof:
        raise CorruptError(f"SPZ: not the {wanted} bytes that {header.count} Gaussians need")
    arrays, offset = [], 0
    for size in header.array_bytes:
        arrays.append(body[offset : offset + size])
        offset += size
    return arrays, body[offset:]


def _zstd_arrays(data: bytes, header: SpzHeader) -> tuple[list[memoryview], memoryview]:
    """The arrays of version 4, and what stands before their table."""
    num_arrays, table_offset = HEADER_V4.unpack_from(data)[6:8]
    wanted = header.array_bytes if header.count else ()
    if num_arrays != len(wanted) and header.count:
        raise CorruptError(f"SPZ: {num_arrays} arrays, not {len(wanted)}")
    offset = table_offset + ENTRY.size * num_arrays
    if table_offset < HEADER_V4.size or len(data) < offset:
        raise CorruptError("SPZ: the table of contents lies outside of the file")
    arrays = []
    entries = ENTRY.iter_unpack(data[table_offset:offset])
    for (size, raw_bytes), expected in zip(entries, wanted, strict=False):
        if raw_bytes != expected:
            raise CorruptError(f"SPZ: an array of {raw_bytes} bytes, not {expected}")
        if offset + size > len(data):
            raise CorruptError(f"SPZ: ends inside an array: {len(data)} bytes of {offset + size}")
        arrays.append(memoryview(_unzstd(data[offset : offset + size], expected)))
        offset += size
    extensions = memoryview(data)[HEADER_V4.size : table_offset]
    return arrays or [memoryview(b"")] * len(header.array_bytes), extensions


def _unzstd(frame: bytes, raw_bytes: int) -> bytes:
    """The `raw_bytes` that the zstd frame holds. Raises CorruptError."""
    what = "SPZ: an array"
    try:
        # One that says its size is given that much memory, whatever the limit.
        said = zstandard.get_frame_parameters(frame).content_size
        if said not in (zstandard.CONTENTSIZE_UNKNOWN, raw_bytes):
            raise CorruptError(f"{what}: declares {said} bytes, not {raw_bytes}")
        content = zstandard.ZstdDecompressor().decompress(
            frame, max_output_size=raw_bytes, read_across_frames=False, allow_extra_data=False
        )
    except zstandard.ZstdError as error:
        raise CorruptError(f"{what}: {error}") from error
    if len(content) != raw_bytes:
        raise CorruptError(f"{what}: {len(content)} bytes, not {raw_bytes}")
    return content


def _rows(array: memoryview, width: int) -> Bytes:
    """(N, width) bytes, a view."""
    return np.frombuffer(array, np.uint8).reshape(-1, width)


def _positions(rows: Bytes, header: SpzHeader) -> Floats:
    if header.version == 1:
        with np.errstate(invalid="ignore"):  # NaN is refused with the Gaussians that have it
            return rows.view("<f2").astype(np.float32)
    low = rows.reshape(-1, 3, 3).astype(np.int32)
    fixed = low[:, :, 0] | low[:, :, 1] << 8 | low[:, :, 2] << 16
    signed = (fixed ^ 0x800000) - 0x800000
    positions: Floats = np.ldexp(signed.astype(np.float32), -header.fractional_bits)
    return positions


def _rotations(rows: Bytes, version: int) -> Floats:
    """(N, 4) w, x, y, z."""
    if version <= 2:
        xyz = rows / 127.5 - 1
        xyzw = restore_largest(xyz, np.full(len(xyz), 3))
    else:
        words = rows.view("<u4")[:, 0].astype(np.uint32)
        fields = words[:, None] >> np.array([20, 10, 0], np.uint32)
        sizes = (fields & 511) / 511 * np.sqrt(0.5)
        xyzw = restore_largest(np.where(fields & 512, -sizes, sizes), words >> np.uint32(30))
    return xyzw[:, [3, 0, 1, 2]].astype(np.float32)


def decode_spz(data: bytes, max_gaussians: int = MAX_GAUSSIANS) -> Splats:
    """The Gaussians of an SPZ file of version 1 to 4.

    Raises CorruptError, or UnsupportedError, also for more than `max_gaussians`.
    """
    header = spz_header(data, len(data), max_gaussians)
    arrays, extensions = (_gzip_arrays if _is_gzip(data) else _zstd_arrays)(data, header)
    axes = _axes_of(extensions) if header.flags & FLAG_EXTENSIONS else None
    if axes is None:
        notes().hint = RAW_HINT
    if header.flags & FLAG_ANTIALIAS:
        tell_model(ANTIALIASED)
    made = Decoded.empty(header.count, header.sh_degree)
    parts = [_rows(array, width) for array, width in zip(arrays, header.widths, strict=False)]
    positions, opacities, colours, scales, rotations = parts[:5]
    for block in made.blocks():
        made.means[block] = _positions(positions[block], header)
        made.logit_opacities[block] = byte_logits(opacities[block, 0])
        made.sh[block, 0] = (colours[block] / 255 - 0.5) / COLOUR_SCALE
        made.log_scales[block] = scales[block].astype(np.float32) / 16 - 10
        made.quats[block] = _rotations(rotations[block], header.version)
        if header.sh_degree:
            rest = parts[5][block].reshape(-1, made.sh.shape[1] - 1, 3)
            made.sh[block, 1:] = (rest.astype(np.float32) - 128) / 128
    return _in_our_axes(made.checked("SPZ"), axes or RUB)


def _fixed_positions(means: Floats) -> tuple[bytes, int]:
    """The array of positions and the fractional bits, which shrink where the scene is huge."""
    largest = float(np.abs(means).max(initial=0.0))
    bits = DEFAULT_FRACTIONAL_BITS
    while bits > 0 and largest * (1 << bits) > 0x7FFFFF:
        bits -= 1
    if largest * (1 << bits) > 0x7FFFFF:
        raise InvalidError(f"SPZ: a position of {largest:g}, at most {0x7FFFFF}")
    fixed = np.rint(np.ldexp(means.astype(np.float64), bits)).astype("<i4")
    low: Bytes = fixed.view(np.uint8).reshape(-1, 3, 4)[:, :, :3]
    return low.tobytes(), bits


def _first_three(quats: Floats) -> bytes:
    """The array of rotations to version 2."""
    unit = unit_quats(quats)
    # A quaternion and its negative are the same rotation; w is taken as positive.
    unit *= np.where(unit[:, :1] < 0, -1.0, 1.0)
    return clipped_bytes(unit[:, 1:] * 127.5 + 127.5).tobytes()


def _smallest_three(quats: Floats) -> bytes:
    """The array of rotations from version 3 on."""
    largest, smaller = split_largest(unit_quats(quats)[:, [1, 2, 3, 0]])
    words = largest.astype(np.uint32)
    for column in smaller.T:
        size = np.minimum(np.rint(np.abs(column) * np.sqrt(2) * 511), 511).astype(np.uint32)
        words = words << np.uint32(10) | np.where(column < 0, np.uint32(512), np.uint32(0)) | size
    packed: bytes = words.astype("<u4").tobytes()
    return packed


def encode_spz(splats: Splats, version: SpzVersion = SpzVersion.V3) -> bytes:
    """The SPZ file of `splats`, which names its axes, every harmonic at its full 8 bits.

    Raises InvalidError for a position beyond 8388607. Clipped: ln s to -10..5.9, f_dc to -3.3..3.3,
    harmonics to -1..1.
    """
    splats = half_turned(splats, "x")
    positions, fractional_bits = _fixed_positions(splats.means)
    wide = splats.sh.astype(np.float64)
    arrays = [
        positions,
        opacity_bytes(splats.opacities).tobytes(),
        clipped_bytes(wide[:, 0] * (COLOUR_SCALE * 255) + 127.5).tobytes(),
        clipped_bytes((splats.log_scales.astype(np.float64) + 10) * 16).tobytes(),
        (_first_three if version == SpzVersion.V2 else _smallest_three)(splats.quats),
        clipped_bytes(wide[:, 1:] * 128 + 128).tobytes(),
    ]
    arrays = [array for array in arrays if array]
    said = (MAGIC, int(version), len(splats), splats.sh_degree, fractional_bits, FLAG_EXTENSIONS)
    if version != SpzVersion.V4:
        stream = zlib.compressobj(GZIP_LEVEL, wbits=31)
        parts = [HEADER.pack(*said, 0), *arrays, AXES_RECORD]
        return stream.compress(b"".join(parts)) + stream.flush()
    compressor = zstandard.ZstdCompressor(level=ZSTD_LEVEL, write_checksum=True)
    frames = [compressor.compress(array) for array in arrays]
    table_offset = HEADER_V4.size + len(AXES_RECORD)
    head = HEADER_V4.pack(*said, len(frames), table_offset, bytes(12)) + AXES_RECORD
    table = b"".join(
        ENTRY.pack(len(frame), len(array)) for frame, array in zip(frames, arrays, strict=True)
    )
    return head + table + b"".join(frames)
