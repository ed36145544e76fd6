"""Sequences in the .splat4d container (adamraudonis/splats4D, version 1): frames of .splat records
with the same Gaussians in each, of which only what changes is sent.

    0   "SP4D", u16 version, u16 flags, u32 bytes of JSON, the JSON
    static section, at the offset that the JSON gives: masks of what never changes, one bit each, of
        position, rotation, colour, opacity, size; then the values of all Gaussians: positions and
        ln sizes as zigzag differences along the file on fine grids, colours, opacities, rotations
    chunks, each of the frames f0..f1: u16 streams; of each stream the head below; the payloads. Of
        every attribute that changes there is a key, its integers at f0, and, if there is more than
        one frame, the differences from frame to frame
    stream  u8 attribute, u8 kind (0 key, 1 differences, 2 static), u8 width, u32 count, u32 bytes;
            payload: zstd of byte planes

An integer times the step of its grid is a position in metres, ln of a size, a level of 255, or 128
times a component of a quaternion. A Gaussian of opacity 0 only holds its place, and is left out.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from codec.errors import CorruptError, UnsupportedError
from codec.files import read_head, read_span
from codec.splats import SH_C0, Splats

from .bytecursor import ByteCursor
from .jsonfields import MAX_JSON_BYTES, Fields
from .levels import Bytes, byte_logits
from .limits import MAX_GAUSSIANS, Decoded, check_count, check_frames, check_ratio
from .packed import WIDTHS, Ints, symbols, unzigzag, unzstd
from .splat import RECORD

MAGIC = b"SP4D"
VERSION = 1
HEAD = struct.Struct("<4sHHI")
STREAM = struct.Struct("<BBBII")
NUM_STREAMS = struct.Struct("<H")
POSITION, ROTATION, COLOUR, OPACITY, SIZE = range(5)
CHANNELS = (3, 4, 3, 1, 3)
STEPS = ("pos", "rot", "rgb", "alpha", "scale_log")
BASE_ORDER = (POSITION, SIZE, COLOUR, OPACITY, ROTATION)
KEY, DIFFERENCES, STATIC = range(3)
MAX_FRAMES = 1 << 20
MAX_SECTION_BYTES = 1 << 30


@dataclass(frozen=True, slots=True)
class _Chunk:
    """A group of frames that is decoded by itself."""

    offset: int
    num_bytes: int
    frames: range


@dataclass(slots=True)
class _Track:
    """How the integers of one attribute go on in a chunk."""

    now: Ints  # (M, channels)
    planes: Bytes  # (width, frames - 1 times M times channels)

    def advance(self, step: int) -> None:
        """Goes on by the differences number `step`."""
        size = self.now.size
        planes = self.planes[:, step * size : (step + 1) * size]
        self.now += unzigzag(symbols(planes.tobytes(), len(planes))).reshape(self.now.shape)


class Splat4dReader:
    """Frames of the .splat4d file at `path`; cheapest in rising order."""

    def __init__(self, path: Path) -> None:
        """Raises CorruptError, or UnsupportedError."""
        self._path = path
        head, self._file_bytes = read_head(path, HEAD.size)
        if len(head) < HEAD.size:
            raise CorruptError(".splat4d: ends inside its header")
        magic, version, _, json_bytes = HEAD.unpack(head)
        if magic != MAGIC or version != VERSION:
            raise UnsupportedError(f".splat4d: version {version}; this program reads {VERSION}")
        if json_bytes > MAX_JSON_BYTES:
            raise CorruptError(f".splat4d: {json_bytes} bytes of JSON")
        header = Fields.parse(read_span(path, HEAD.size, json_bytes), ".splat4d")
        self._count = check_count(".splat4d", header.integer("n", most=1 << 53))
        check_ratio(".splat4d", self._count * RECORD.itemsize, self._file_bytes)
        self.num_frames = header.integer("t", most=MAX_FRAMES)
        check_frames(".splat4d", self.num_frames, self._file_bytes)
        self.fps = header.number("fps")
        """Frames in a second."""
        steps = header.fields("steps")
        self._steps = [steps.number(name) for name in STEPS]
        self._base_steps = [steps.number(f"base_{STEPS[n]}") for n in (POSITION, SIZE)]
        self._static = self._section(header.fields("static_section"))
        self._chunks = [self._chunk(fields) for fields in header.items("gops")]
        found = [frame for chunk in self._chunks for frame in (chunk.frames[0], chunk.frames[-1])]
        if not found or found[0] != 0 or found[-1] != self.num_frames - 1:
            raise CorruptError(".splat4d: its chunks do not hold its frames")
        if any(b - a != 1 for a, b in zip(found[1::2], found[2::2], strict=False)):
            raise CorruptError(".splat4d: its chunks do not follow on each other")
        self._rows: list[npt.NDArray[np.intp]] | None = None
        """Of each attribute: which Gaussians change it."""
        self._base: list[Ints] = []
        self._tracks: dict[int, _Track] = {}
        self._at: tuple[int, int] | None = None
        """The chunk and the frame that the tracks have come to."""

    def _section(self, fields: Fields) -> tuple[int, int]:
        offset, num_bytes = (fields.integer(key, most=1 << 53) for key in ("offset", "len"))
        if num_bytes > MAX_SECTION_BYTES or offset + num_bytes > self._file_bytes:
            raise CorruptError(f"{fields.where}: {num_bytes} bytes from {offset} on are not there")
        return offset, num_bytes

    def _chunk(self, fields: Fields) -> _Chunk:
        offset, num_bytes = self._section(fields)
        first, last = (fields.integer(key, most=MAX_FRAMES) for key in ("f0", "f1"))
        if first > last:
            raise CorruptError(f"{fields.where}: has no frame")
        return _Chunk(offset, num_bytes, range(first, last + 1))

    def read(self, frame: int, max_gaussians: int = MAX_GAUSSIANS) -> Splats:
        """The Gaussians that show at `frame`, 0 to num_frames - 1. Raises CorruptError, or
        UnsupportedError, also for a file of more than `max_gaussians`."""
        check_count(".splat4d", self._count, max_gaussians)
        if self._rows is None:
            self._read_static()
        number = next(n for n, chunk in enumerate(self._chunks) if frame in chunk.frames)
        chunk = self._chunks[number]
        if self._at is None or self._at[0] != number or self._at[1] > frame:
            self._at, self._tracks = None, {}  # let go of it before the next is read
            self._tracks = self._read_chunk(chunk)
            self._at = number, chunk.frames[0]
        for step in range(self._at[1] - chunk.frames[0], frame - chunk.frames[0]):
            for track in self._tracks.values():
                track.advance(step)
        self._at = number, frame
        return self._splats()

    def _numbers(self, cursor: ByteCursor, count: int, what: str) -> npt.NDArray[np.uint32]:
        """The `count` numbers of the next stream of the static section."""
        _, kind, width, found, num_bytes = cursor.fields(STREAM)
        if kind != STATIC:
            raise CorruptError(f"{what}: a stream of kind {kind}, not {STATIC}")
        return symbols(_planes(cursor.take(num_bytes), width, found, count, what), width)

    def _read_static(self) -> None:
        what, count = ".splat4d: static section", self._count
        cursor = ByteCursor(read_span(self._path, *self._static), what)
        rows = []
        for _ in CHANNELS:
            mask = self._numbers(cursor, -(-count // 8), what).astype(np.uint8)
            rows.append(np.flatnonzero(np.unpackbits(mask)[:count] == 0))
        base: dict[int, Ints] = {}
        for kind in BASE_ORDER:
            numbers = self._numbers(cursor, count * CHANNELS[kind], what)
            shaped = numbers.reshape(count, CHANNELS[kind])
            if kind in (POSITION, SIZE):
                base[kind] = np.cumsum(unzigzag(shaped), axis=0, dtype=np.int64)
            else:
                base[kind] = shaped.astype(np.int64)
        self._base = [base[kind] for kind in range(len(CHANNELS))]
        self._rows = rows

    def _read_chunk(self, chunk: _Chunk) -> dict[int, _Track]:
        """The tracks of a chunk, at its first frame."""
        assert self._rows is not None
        what = f".splat4d: chunk at {chunk.offset}"
        cursor = ByteCursor(read_span(self._path, chunk.offset, chunk.num_bytes), what)
        (num_streams,) = cursor.fields(NUM_STREAMS)
        heads = [cursor.fields(STREAM) for _ in range(num_streams)]
        found: dict[tuple[int, int], tuple[int, bytes]] = {}
        for kind, role, width, count, num_bytes in heads:
            if kind >= len(CHANNELS) or role not in (KEY, DIFFERENCES) or (kind, role) in found:
                raise CorruptError(f"{what}: a stream of attribute {kind} and kind {role}")
            steps = 1 if role == KEY else len(chunk.frames) - 1
            wanted = steps * len(self._rows[kind]) * CHANNELS[kind]
            planes = _planes(cursor.take(num_bytes), width, count, wanted, what)
            found[kind, role] = width, planes
        tracks = {}
        for kind, rows in enumerate(self._rows):
            if not len(rows):
                continue
            if (kind, KEY) not in found or (len(chunk.frames) > 1 and (kind, 1) not in found):
                raise CorruptError(f"{what}: a stream of attribute {kind} is missing")
            width, key = found[kind, KEY]
            now = unzigzag(symbols(key, width)).reshape(len(rows), CHANNELS[kind])
            width, planes = found.get((kind, DIFFERENCES), (1, b""))
            tracks[kind] = _Track(now, np.frombuffer(planes, np.uint8).reshape(width, -1))
        return tracks

    def _splats(self) -> Splats:
        """The Gaussians as they are now, without those of opacity 0."""
        opacities = self._levels(OPACITY)
        shown = np.flatnonzero(opacities[:, 0])
        made = Decoded.empty(len(shown), 0)
        with np.errstate(over="ignore"):  # infinities are refused by `checked`
            made.means[:] = self._values(POSITION, self._base_steps[0])[shown]
            made.log_scales[:] = self._values(SIZE, self._base_steps[1])[shown]
        turns = self._base[ROTATION] - 128
        turns[self._changing(ROTATION)] = self._changed(ROTATION)
        made.quats[:] = np.clip(turns, -128, 127)[shown] / 128
        made.logit_opacities[:] = byte_logits(opacities[shown, 0])
        made.sh[:, 0] = (self._levels(COLOUR)[shown] / 255 - 0.5) / SH_C0
        return made.checked(".splat4d")

    def _changing(self, kind: int) -> npt.NDArray[np.intp]:
        assert self._rows is not None
        return self._rows[kind]

    def _changed(self, kind: int) -> npt.NDArray[np.float64]:
        """(M, channels) what those that change have now."""
        track = self._tracks.get(kind)
        if track is None:
            return np.zeros((0, CHANNELS[kind]))
        return np.multiply(track.now, self._steps[kind], dtype=np.float64)

    def _values(self, kind: int, base_step: float) -> npt.NDArray[np.float64]:
        values = np.multiply(self._base[kind], base_step, dtype=np.float64)
        values[self._changing(kind)] = self._changed(kind)
        return values

    def _levels(self, kind: int) -> Bytes:
        levels = self._values(kind, 1.0)
        return np.clip(levels, 0, 255).astype(np.uint8)


def _planes(payload: memoryview, width: int, count: int, wanted: int, what: str) -> bytes:
    """The byte planes of a stream that should have `wanted` numbers."""
    if width not in WIDTHS or count != wanted:
        raise CorruptError(f"{what}: {count} numbers of {width} bytes, not {wanted}")
    if count * width > MAX_SECTION_BYTES:
        raise CorruptError(f"{what}: claims {count * width} bytes")
    check_ratio(what, count * width, len(payload))
    return unzstd(payload, count * width, what)
