"""One file for a whole stream, a ZIP file whose entries are stored as they are: where each file
lies in it, and the records around them.

Rule: pure. Nothing is looked up: sizes from the file's head and from the index give every place, so
no two files can overlap, and a reader needs nothing but the first bytes. A table has the sizes that
the index does not know, of captions and sound. Equal streams have equal bytes; ZIP64 appears only
where a number does not fit.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from codec.arrays import Longs
from codec.errors import CodecError, CorruptError, UnsupportedError

from .captions import MAX_CAPTIONS_BYTES
from .integrity import MAX_INDEX_BYTES, check_index_end, read_index
from .manifest import (
    MANIFEST_NAME,
    MAX_MANIFEST_BYTES,
    SEGMENTS_NAME,
    SKIP_MAPS,
    Manifest,
    Part,
    keyframe_part,
    object_name,
)
from .pictures import MAX_PICTURE_BYTES, picture_path
from .segment import INDEX_NAME, SegmentRecord
from .sound import MAX_SOUND_BYTES

# signature, version needed, flags, method, time, date, CRC-32, size stored, size, name bytes,
# extra bytes
LOCAL = struct.Struct("<IHHHHHIIIHH")
# signature, made by, version needed, flags, method, time, date, CRC-32, size stored, size, name
# bytes, extra bytes, comment bytes, disk, internal attributes, external attributes, place
CENTRAL = struct.Struct("<IHHHHHHIIIHHHHHII")
# header, bytes, place
PLACE_EXTRA = struct.Struct("<HHQ")
# signature, bytes that follow, made by, version needed, disk, disk of the directory, entries of
# the disk, entries, directory's bytes, directory's place
END_64 = struct.Struct("<IQHHIIQQQQ")
# signature, disk of the record above, its place, disks
LOCATOR_64 = struct.Struct("<IIQI")
# signature, disk, disk of the directory, entries of the disk, entries, directory's bytes,
# directory's place, comment bytes
END = struct.Struct("<IHHHHIIH")
assert LOCAL.size == 30
assert CENTRAL.size == 46
assert (END_64.size, LOCATOR_64.size, END.size) == (56, 20, 22)

LOCAL_MAGIC = 0x04034B50
CENTRAL_MAGIC = 0x02014B50
END_64_MAGIC = 0x06064B50
LOCATOR_64_MAGIC = 0x07064B50
END_MAGIC = 0x06054B50

MOST_32 = 0xFFFFFFFF
"""A place or size from here on stands in a ZIP64 record instead."""
MOST_16 = 0xFFFF

_STORED_VERSION = 10
_ZIP64_VERSION = 45
_UTF8_NAME = 0x0800
_FIRST_DATE = 0x0021  # 1 January 1980: equal streams make equal files
_UNIX = 3 << 8
_PLAIN_FILE = 0o100644 << 16


@dataclass(frozen=True, slots=True)
class ZipEntry:
    """A file in a ZIP file."""

    name: str
    size_bytes: int
    """Below 2^32 - 1."""
    crc32: int
    header_at: int
    """Where its local header begins, which its bytes follow."""

    @property
    def utf8_name(self) -> bytes:
        return self.name.encode()


def local_bytes(name: str, extra_bytes: int = 0) -> int:
    """The size of the local header of an entry called `name`."""
    return LOCAL.size + len(name.encode()) + extra_bytes


def local_header(entry: ZipEntry, extra: bytes = b"") -> bytes:
    """The header before the bytes of `entry`."""
    name = entry.utf8_name
    return LOCAL.pack(LOCAL_MAGIC, *_fields(entry, _STORED_VERSION, extra)) + name + extra


def _fields(entry: ZipEntry, version: int, extra: bytes) -> tuple[int, ...]:
    """What both headers of an entry say of it, from the version needed to the extra field."""
    sizes = entry.size_bytes, entry.size_bytes
    lengths = len(entry.utf8_name), len(extra)
    return version, _UTF8_NAME, 0, 0, _FIRST_DATE, entry.crc32, *sizes, *lengths


def _central_header(entry: ZipEntry) -> bytes:
    name, is_far = entry.utf8_name, entry.header_at >= MOST_32
    extra = PLACE_EXTRA.pack(1, 8, entry.header_at) if is_far else b""
    version = _ZIP64_VERSION if is_far else _STORED_VERSION
    head = CENTRAL.pack(
        CENTRAL_MAGIC,
        _UNIX | version,
        *_fields(entry, version, extra),
        0,
        0,
        0,
        _PLAIN_FILE,
        min(entry.header_at, MOST_32),
    )
    return head + name + extra


def directory(entries: Iterable[ZipEntry], begin: int) -> Iterator[bytes]:
    """The end of a ZIP file, piece by piece: the directory of `entries`, which begins at `begin`,
    and the records that lead to it."""
    count = size_bytes = 0
    for entry in entries:
        header = _central_header(entry)
        count, size_bytes = count + 1, size_bytes + len(header)
        yield header
    if _needs_64(count, size_bytes, begin):
        version = _ZIP64_VERSION
        rest = END_64.size - 12
        counts = 0, 0, count, count
        yield END_64.pack(END_64_MAGIC, rest, version, version, *counts, size_bytes, begin)
        yield LOCATOR_64.pack(LOCATOR_64_MAGIC, 0, begin + size_bytes, 1)
    shown, place = min(count, MOST_16), min(begin, MOST_32)
    yield END.pack(END_MAGIC, 0, 0, shown, shown, min(size_bytes, MOST_32), place, 0)


def directory_bytes(count: int, names_bytes: int, num_far: int, begin: int) -> int:
    """The size of `directory`. names_bytes: of all `count` names together. num_far: entries whose
    header begins at or after MOST_32."""
    size_bytes = count * CENTRAL.size + names_bytes + num_far * PLACE_EXTRA.size
    is_64 = _needs_64(count, size_bytes, begin)
    return size_bytes + END.size + is_64 * (END_64.size + LOCATOR_64.size)


def _needs_64(count: int, size_bytes: int, begin: int) -> bool:
    return count >= MOST_16 or size_bytes >= MOST_32 or begin >= MOST_32


TRACKS_NAME = ".tracks"
"""The name of the table in the file: of a folder, readers ignore such a name."""

_SIZE = np.dtype("<u4")


def tracks_bytes(manifest: Manifest, num_segments: int) -> int:
    """The size of the table of such a stream; 0 without captions and sound."""
    return _SIZE.itemsize * (len(manifest.captions) + num_segments * len(manifest.sound))


@dataclass(frozen=True, slots=True)
class TrackSizes:
    """The table. All numbers are bytes."""

    captions: tuple[int, ...]
    """Of each file of captions, in the manifest's order."""
    sound: Longs
    """(segments, sources) of each object of sound, the sources in the manifest's order."""

    def to_bytes(self) -> bytes:
        sizes = np.concatenate([np.array(self.captions, np.int64), self.sound.ravel()])
        return sizes.astype(_SIZE).tobytes()

    @staticmethod
    def parse(data: bytes, manifest: Manifest, num_segments: int) -> TrackSizes:
        """The table in `data`. Raises CorruptError."""
        wanted = tracks_bytes(manifest, num_segments)
        if len(data) != wanted:
            raise CorruptError(
                f"packed stream: {len(data)} bytes for the sizes of captions and sound, but by its "
                f"manifest and index they take {wanted}",
                0,
            )
        sizes = np.frombuffer(data, _SIZE).astype(np.int64)
        count = len(manifest.captions)
        limits = np.full(len(sizes), MAX_SOUND_BYTES)
        limits[:count] = MAX_CAPTIONS_BYTES
        wrong = np.flatnonzero((sizes < 1) | (sizes > limits))
        if len(wrong):
            at = int(wrong[0])
            what = "captions" if at < count else "sound"
            raise CorruptError(f"packed stream: {what} of {sizes[at]} bytes", at * _SIZE.itemsize)
        sound = sizes[count:].reshape(num_segments, len(manifest.sound))
        return TrackSizes(tuple(map(int, sizes[:count])), sound)


PACKED_SUFFIX = ".swings"
"""The suffix of a packed stream's name."""

EXTRA_ID = 0x5753
"""Marks the extra field of the first local header: `SW`."""

LAYOUT_VERSION = 1

# id, bytes that follow, version, reserved; bytes of index, poster, storyboard and table of sizes
EXTRA = struct.Struct("<HHHHIIII")
assert EXTRA.size == 24

MANIFEST_AT = local_bytes(MANIFEST_NAME, EXTRA.size)
"""Where the manifest begins."""

FIRST_BYTES = 32 << 10
"""A reader asks for so many bytes first: in most streams they hold the manifest and the index."""


@dataclass(frozen=True, slots=True)
class PackedHead:
    """The sizes that no other part of the file tells, bytes."""

    manifest_bytes: int
    index_bytes: int
    poster_bytes: int
    """0 for none."""
    storyboard_bytes: int
    """0 for none, and for one that is the poster as well."""
    tracks_bytes: int = 0
    """Of the table of the sizes of captions and sound; 0 without any."""

    @property
    def index_at(self) -> int:
        return MANIFEST_AT + self.manifest_bytes + local_bytes(INDEX_NAME)

    @property
    def index_end(self) -> int:
        return self.index_at + self.index_bytes

    @property
    def tracks_at(self) -> int:
        return self.end - self.tracks_bytes

    @property
    def end(self) -> int:
        """Where the index, or the table, ends: a reader needs the bytes before it to find all
        others."""
        header_bytes = local_bytes(TRACKS_NAME) if self.tracks_bytes else 0
        return self.index_end + header_bytes + self.tracks_bytes

    @property
    def extra(self) -> bytes:
        """The extra field of the manifest's local header."""
        sizes = self.index_bytes, self.poster_bytes, self.storyboard_bytes, self.tracks_bytes
        return EXTRA.pack(EXTRA_ID, EXTRA.size - 4, LAYOUT_VERSION, 0, *sizes)

    @staticmethod
    def parse(data: bytes) -> PackedHead:
        """The head of a file that begins with `data`. Raises CorruptError, or UnsupportedError for
        another layout."""
        if len(data) < MANIFEST_AT:
            raise CorruptError(f"packed stream: {len(data)} bytes are too few", len(data))
        magic, *_, size_bytes, stored_bytes, name_bytes, extra_bytes = LOCAL.unpack_from(data)
        name = data[LOCAL.size : LOCAL.size + len(MANIFEST_NAME)]
        extra_at = LOCAL.size + len(MANIFEST_NAME)
        extra = EXTRA.unpack_from(data, extra_at)
        known = (LOCAL_MAGIC, len(MANIFEST_NAME), extra_bytes, EXTRA_ID)
        if (magic, name_bytes, extra[1] + 4, extra[0]) != known or name != MANIFEST_NAME.encode():
            raise CorruptError(
                "packed stream: does not begin as one; make it with swings-stream pack", 0
            )
        _, _, version, reserved, index_bytes, *pictures, tracks_bytes = extra
        if version != LAYOUT_VERSION or reserved:
            raise UnsupportedError(
                f"packed stream: layout {version}, and this program reads {LAYOUT_VERSION}; pack "
                "the stream anew",
                extra_at + 4,
            )
        if extra_bytes != EXTRA.size:
            raise CorruptError(f"packed stream: {extra_bytes} bytes about its sizes", 28)
        if tracks_bytes > MAX_INDEX_BYTES:
            raise CorruptError(f"packed stream: a table of {tracks_bytes} bytes", extra_at + 20)
        if size_bytes != stored_bytes or not 0 < size_bytes <= MAX_MANIFEST_BYTES:
            raise CorruptError(f"packed stream: a manifest of {size_bytes} bytes", 18)
        if not 0 < index_bytes <= MAX_INDEX_BYTES:
            raise CorruptError(f"packed stream: an index of {index_bytes} bytes", extra_at + 8)
        for number, picture_bytes in enumerate(pictures):
            if picture_bytes > MAX_PICTURE_BYTES:
                message = f"packed stream: a picture of {picture_bytes} bytes"
                raise CorruptError(message, extra_at + 12 + 4 * number)
        poster_bytes, storyboard_bytes = pictures
        return PackedHead(size_bytes, index_bytes, poster_bytes, storyboard_bytes, tracks_bytes)


def packed_parts(num_layers: int) -> tuple[Part, ...]:
    """The parts of a segment as they lie in the file. What a player of n layers fetches lies side
    by side, with keyframes or without, for every n."""
    layers = range(num_layers)
    return (*(keyframe_part(layer) for layer in reversed(layers)), SKIP_MAPS, *layers)


class PackedLayout:
    """Where the files of one stream lie. `find` gives the places; all numbers are bytes."""

    def __init__(
        self,
        head: PackedHead,
        manifest: Manifest,
        records: Sequence[SegmentRecord],
        tracks: bytes = b"",
    ) -> None:
        """tracks: the table of a stream with sound or captions. Raises CorruptError if it is wrong,
        or if the head names pictures that the manifest does not."""
        self.head = head
        self.manifest = manifest
        self.records = records
        try:
            self.tracks = TrackSizes.parse(tracks, manifest, len(records))
        except CorruptError as error:
            raise error.moved(head.tracks_at) from error
        captions = [each.file_name for each in manifest.captions]
        self._beside = _pictures(head, manifest)
        """Paths and sizes of pictures and captions, as they follow each other."""
        self._beside += zip(captions, self.tracks.captions, strict=True)
        sources = [source.part for source in manifest.sound]
        self._parts = (*sources, *packed_parts(manifest.num_layers))
        self._column = {part: column for column, part in enumerate(self._parts)}
        objects_at = head.end + sum(local_bytes(name) + size for name, size in self._beside)
        order = [manifest.part_number(part) for part in self._parts[len(sources) :]]
        sizes = np.array([record.part_bytes for record in records], np.int64)[:, order]
        sizes = np.concatenate([self.tracks.sound, sizes], axis=1)
        names = _name_bytes(self._parts, len(records))
        steps = LOCAL.size + names + sizes
        ends = objects_at + np.cumsum(steps).reshape(steps.shape)
        self._sizes = sizes
        self._places = ends - sizes
        self.directory_at = int(ends[-1, -1])
        fixed = self._fixed
        names_bytes = int(names.sum()) + sum(len(name.encode()) for name in fixed)
        num_far = int(np.count_nonzero(ends - steps >= MOST_32))
        count = len(fixed) + sizes.size
        self.size_bytes = self.directory_at + directory_bytes(
            count, names_bytes, num_far, self.directory_at
        )

    @property
    def _fixed(self) -> list[str]:
        """Paths of what lies before the segments."""
        tables = [TRACKS_NAME] if self.head.tracks_bytes else []
        return [MANIFEST_NAME, INDEX_NAME, *tables, *(name for name, _ in self._beside)]

    @staticmethod
    def parse(
        head: PackedHead, manifest_json: bytes, index: bytes, tracks: bytes = b""
    ) -> PackedLayout:
        """The layout of a file with this head, manifest, index and table. Raises a CodecError,
        whose place is one in the file."""
        try:
            manifest = Manifest.from_json(manifest_json)
        except CodecError as error:
            raise error.moved(MANIFEST_AT) from error
        if manifest.live:
            raise CorruptError("packed stream: its manifest says that it is live")
        try:
            records = read_index(index, manifest)
            check_index_end(len(index), manifest, len(records))
        except CodecError as error:
            raise error.moved(head.index_at) from error
        return PackedLayout(head, manifest, records, tracks)

    def check_size(self, file_bytes: int) -> None:
        """Raises CorruptError unless a file of `file_bytes` is whole."""
        if file_bytes != self.size_bytes:
            raise CorruptError(
                f"packed stream: {file_bytes} bytes, but by its index it has {self.size_bytes}; "
                "was the copy cut short?",
                min(file_bytes, self.size_bytes),
            )

    def object(self, segment: int, part: Part) -> tuple[int, int]:
        """Where the object of (segment, part), which there is, begins, and its size."""
        column = self._column[part]
        return int(self._places[segment, column]), int(self._sizes[segment, column])

    def find(self, path: str) -> tuple[int, int] | None:
        """Where the file at `path` begins, and its size; None if there is none."""
        if path == MANIFEST_NAME:
            return MANIFEST_AT, self.head.manifest_bytes
        if path == INDEX_NAME:
            return self.head.index_at, self.head.index_bytes
        if path == TRACKS_NAME and self.head.tracks_bytes:
            return self.head.tracks_at, self.head.tracks_bytes
        at = self.head.end
        for name, size_bytes in self._beside:
            at += local_bytes(name)
            if name == path:
                return at, size_bytes
            at += size_bytes
        found = self.address(path)
        return None if found is None else self.object(*found)

    def address(self, path: str) -> tuple[int, Part] | None:
        """Segment and part of the object at `path`; None if there is none."""
        folder, _, rest = path.partition("/")
        number, _, name = rest.partition("/")
        part: Part = int(name) if _is_number(name) else name
        is_here = _is_number(number) and int(number) < len(self.records) and part in self._column
        return (int(number), part) if folder == SEGMENTS_NAME and is_here else None

    def files(self) -> Iterator[tuple[str, int, int]]:
        """All files in order: path, where its bytes begin, and their number."""
        for path in self._fixed:
            at, size_bytes = self.find(path) or (0, 0)
            yield path, at, size_bytes
        for segment in range(len(self.records)):
            for part in self._parts:
                yield object_name(segment, part), *self.object(segment, part)

    def structure(self, crc32_of: Callable[[str], int]) -> Iterator[tuple[int, bytes]]:
        """All that makes a ZIP file of the files, in order: places and bytes. crc32_of: gives the
        CRC-32 of the file at a path; it is called for each file, in order."""
        checksums = array("I")  # of a long stream too many for an object each
        for entry, extra in self._entries():
            checksums.append(crc32_of(entry.name))
            header = local_header(replace(entry, crc32=checksums[-1]), extra)
            yield entry.header_at, header
        at = self.directory_at
        pairs = zip(self._entries(), checksums, strict=True)
        entries = (replace(entry, crc32=crc32) for (entry, _), crc32 in pairs)
        for piece in directory(entries, at):
            yield at, piece
            at += len(piece)

    def _entries(self) -> Iterator[tuple[ZipEntry, bytes]]:
        """The entries of the ZIP file in order, without their checksums, each with the extra field
        of its local header."""
        for path, at, size_bytes in self.files():
            extra = self.head.extra if path == MANIFEST_NAME else b""
            yield ZipEntry(path, size_bytes, 0, at - local_bytes(path, len(extra))), extra


ReadRange = Callable[[int, int], tuple[bytes, int]]
"""Gives the bytes of a file from an offset on, so many at most and fewer only at its end, and the
size of the file."""


def read_layout(read: ReadRange, max_index_bytes: int = MAX_INDEX_BYTES) -> PackedLayout:
    """The layout of the file that `read` reads from, which is whole by its index. Reads twice if
    manifest and index are longer than FIRST_BYTES, else once. Raises a CodecError, whose place is
    one in the file, and what `read` raises."""
    data, file_bytes = read(0, FIRST_BYTES)
    head = PackedHead.parse(data)
    largest_bytes = max(head.index_bytes, head.tracks_bytes)
    if largest_bytes > max_index_bytes:
        raise UnsupportedError(
            f"packed stream: an index of {largest_bytes} bytes; {max_index_bytes} can be read"
        )
    if head.end > file_bytes:
        raise CorruptError("packed stream: ends before its index does", file_bytes)
    if head.end > len(data):
        rest, _ = read(len(data), head.end - len(data))
        data += rest
    manifest_json = data[MANIFEST_AT : MANIFEST_AT + head.manifest_bytes]
    index, tracks = data[head.index_at : head.index_end], data[head.tracks_at : head.end]
    layout = PackedLayout.parse(head, manifest_json, index, tracks)
    layout.check_size(file_bytes)
    return layout


def picture_paths(manifest: Manifest) -> tuple[str | None, str | None]:
    """Paths of the poster and of the storyboard, where a packed stream may have them: a picture
    that is both lies there as the poster."""
    poster, storyboard = picture_path(manifest.poster), picture_path(manifest.storyboard)
    return poster, None if storyboard == poster else storyboard


def _pictures(head: PackedHead, manifest: Manifest) -> list[tuple[str, int]]:
    found = []
    sizes, names = (head.poster_bytes, head.storyboard_bytes), ("poster", "storyboard")
    for path, size_bytes, what in zip(picture_paths(manifest), sizes, names, strict=True):
        if not size_bytes:
            continue
        if path is None:
            raise CorruptError(f"packed stream: a {what} that the manifest does not name")
        found.append((path, size_bytes))
    return found


def _name_bytes(parts: tuple[Part, ...], num_segments: int) -> Longs:
    """(segments, parts) sizes of the names of all objects."""
    digits = np.ones(num_segments, np.int64)
    power = 10
    while power < num_segments:
        digits[power:] += 1
        power *= 10
    suffixes = np.array([len(object_name(0, part)) - 1 for part in parts], np.int64)
    found: Longs = digits[:, None] + suffixes[None, :]
    return found


def _is_number(text: str) -> bool:
    """Whether `text` is a number as names of files have it."""
    return text.isascii() and text.isdecimal() and len(text) <= 9 and str(int(text)) == text
