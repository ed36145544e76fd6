"""The .ksplat file (mkkellogg/GaussianSplats3D, version 0.1), in. Little-endian, without a magic.

    header   4096 bytes: u8 major, u8 minor; at 4 u32 sections, those in use, most Gaussians,
             Gaussians, u16 level; at 36 f32 least and largest harmonic of level 2
    sections 1024 bytes each: u32 Gaussians, room, bucket size, buckets, f32 block size, u16 bytes
             of a bucket, at 24 u32 range, at 32 u32 full buckets, partial buckets, u16 SH degree
    then of each section: u32 lengths of the partial buckets, f32 x 3 centres of the buckets,
             records for its room

A record: centre, size and rotation w x y z as f32 (level 0) or f16 (1, 2), of which the centre is
u16 x 3 in steps of half a block over the range from the bucket's centre; red, green, blue
(0.5 + SH_C0 f_dc) * 255 and opacity * 255 as u8; harmonics as f32, f16 or u8 between the least and
the largest: those of degree 1, then those of degree 2, each red, green, blue. Sizes are linear; the
frame is that of the PLY, RDF. What there is no own value for is 0 and has a default.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from codec.arrays import Doubles, Floats
from codec.errors import CorruptError, UnsupportedError
from codec.splats import SH_C0, Splats, sh_count

from .bounds import MAX_GAUSSIANS, Decoded, byte_logits, check_count
from .splat import SMALLEST_SCALE

HEADER = struct.Struct("<BBxxIIIIHxx12xff")
HEADER_BYTES, SECTION_BYTES = 4096, 1024
SECTION = struct.Struct("<IIIIfHxxI4xIIH")
MAX_DEGREE = 2
DEFAULT_REACH = 1.5
"""Of harmonics in bytes."""
DEFAULT_RANGE = 32767
FLOATS = ("<f4", "<f2", "<f2")
HARMONICS = ("<f4", "<f2", "<u1")
"""By level."""
BUCKET_BYTES = 12


@dataclass(frozen=True, slots=True)
class _Section:
    """Some of the Gaussians, and where they lie."""

    count: int
    sh_degree: int
    records: npt.NDArray[np.void]
    bucket_size: int
    num_full: int
    step: float
    range: int
    centres: Doubles  # (B, 3)
    lengths: npt.NDArray[np.uint32]

    def bucket_centres(self) -> Doubles:
        """(N, 3) the centre of the bucket of each Gaussian. Raises CorruptError."""
        in_full = np.arange(min(self.count, self.num_full * self.bucket_size))
        in_full //= max(self.bucket_size, 1)
        # A partial bucket has at least one Gaussian, and none more than are left.
        rest = self.count - len(in_full)
        lengths = np.minimum(self.lengths.astype(np.int64), rest)
        in_partial = np.repeat(np.arange(len(lengths)), lengths)[:rest] + self.num_full
        buckets = np.concatenate([in_full, in_partial])
        if len(buckets) < self.count or buckets.max(initial=-1) >= len(self.centres):
            raise CorruptError(".ksplat: a Gaussian is in no bucket")
        centres: Doubles = self.centres[buckets]
        return centres


def _record(level: int, sh_degree: int) -> np.dtype[np.void]:
    centre = "<f4" if level == 0 else "<u2"
    fields = [("centre", centre, 3), ("scale", FLOATS[level], 3), ("rot", FLOATS[level], 4)]
    fields += [("rgba", "u1", 4), ("sh", HARMONICS[level], 3 * (sh_count(sh_degree) - 1))]
    return np.dtype(fields)


def ksplat_count(head: bytes, file_bytes: int, max_gaussians: int = MAX_GAUSSIANS) -> int:
    """The Gaussians that a .ksplat file of `file_bytes` that begins with `head` claims.

    Raises CorruptError, or UnsupportedError, also for more than `max_gaussians`.
    """
    if file_bytes < HEADER_BYTES or len(head) < HEADER.size:
        raise CorruptError(f".ksplat: ends inside its header of {HEADER_BYTES} bytes")
    major, minor, sections, _, _, count, level, *_ = HEADER.unpack_from(head)
    if (major, minor) != (0, 1) or level >= len(FLOATS):
        raise UnsupportedError(
            f".ksplat: version {major}.{minor}, level {level}; this program reads 0.1, 0 to 2"
        )
    if HEADER_BYTES + sections * SECTION_BYTES > file_bytes:
        raise CorruptError(f".ksplat: claims {sections} sections in {file_bytes} bytes")
    return check_count(".ksplat", count, max_gaussians)


def _sections(data: bytes, num_sections: int, level: int) -> list[_Section]:
    sections = []
    at = HEADER_BYTES + num_sections * SECTION_BYTES
    for number in range(num_sections):
        count, room, size, buckets, block, bucket_bytes, reach, full, partial, degree = (
            SECTION.unpack_from(data, HEADER_BYTES + number * SECTION_BYTES)
        )
        if degree > MAX_DEGREE:
            raise UnsupportedError(f".ksplat: SH degree {degree}; this program reads 0 to 2")
        if count > room or (level and buckets and bucket_bytes != BUCKET_BYTES):
            raise CorruptError(f".ksplat: section {number} has more Gaussians than room for them")
        record = _record(level, degree)
        ends = np.cumsum([at, 4 * partial, buckets * bucket_bytes, room * record.itemsize])
        if ends[-1] > len(data):
            raise CorruptError(f".ksplat: ends after {len(data)} bytes of {ends[-1]}")
        lengths = np.frombuffer(data, "<u4", partial, ends[0])
        centres = np.frombuffer(data, "<f4", 3 * buckets if bucket_bytes else 0, ends[1])
        reach = reach or DEFAULT_RANGE
        sections.append(
            _Section(
                count,
                degree,
                np.frombuffer(data, record, count, ends[2]),
                size,
                full,
                block / 2 / reach,
                reach,
                centres.reshape(-1, 3).astype(np.float64),
                lengths,
            )
        )
        at = int(ends[-1])
    return sections


def _harmonics(values: Floats, degree: int) -> Floats:
    """(N, K - 1, 3) coefficients of the (N, 3 (K - 1)) that a file has."""
    bands = []
    for band in range(1, degree + 1):
        first, last = 3 * (sh_count(band - 1) - 1), 3 * (sh_count(band) - 1)
        by_channel = values[:, first:last].reshape(len(values), 3, 2 * band + 1)
        bands.append(by_channel.swapaxes(1, 2))
    return np.concatenate(bands, axis=1)


def decode_ksplat(data: bytes, max_gaussians: int = MAX_GAUSSIANS) -> Splats:
    """The Gaussians of a .ksplat file, in its order. Raises CorruptError, or UnsupportedError, also
    for more than `max_gaussians`."""
    count = ksplat_count(data, len(data), max_gaussians)
    num_sections, level, least, largest = (HEADER.unpack_from(data)[n] for n in (2, 6, 7, 8))
    least, largest = least or -DEFAULT_REACH, largest or DEFAULT_REACH
    sections = _sections(data, num_sections, level)
    if sum(section.count for section in sections) != count:
        raise CorruptError(f".ksplat: not {count} Gaussians in its {len(sections)} sections")
    degree = max((section.sh_degree for section in sections if section.count), default=0)
    made = Decoded.empty(count, degree)
    made.sh[:] = 0
    first = 0
    for section in sections:
        rows = section.records
        part = slice(first, first := first + section.count)
        with np.errstate(all="ignore"):  # infinities and NaN are refused here or below
            if level:
                steps = rows["centre"].astype(np.float64) - section.range
                made.means[part] = steps * section.step + section.bucket_centres()
            else:
                made.means[part] = rows["centre"]
            scales = rows["scale"].astype(np.float64)
            if not (scales >= 0).all():
                raise CorruptError(".ksplat: a standard deviation is negative or not a number")
            made.log_scales[part] = np.log(np.maximum(scales, SMALLEST_SCALE))
            made.quats[part] = rows["rot"]
            harmonics = rows["sh"].astype(np.float64)
            if level == 2:
                harmonics = harmonics / 255 * (largest - least) + least
            if section.sh_degree:
                values = _harmonics(harmonics.astype(np.float32), section.sh_degree)
                made.sh[part, 1 : 1 + values.shape[1]] = values
        made.logit_opacities[part] = byte_logits(rows["rgba"][:, 3])
        made.sh[part, 0] = (rows["rgba"][:, :3] / 255 - 0.5) / SH_C0
    return made.checked(".ksplat")
