"""One object that comes in pieces: which of its bytes to ask for, and the packets in what has come.

Rule: no I/O. What was asked for comes, or the play ends: nothing is asked for twice.
"""

from __future__ import annotations

import math
from bisect import bisect_right

from codec.errors import CodecError, CorruptError
from codec.stream.index import SegmentRecord
from codec.stream.integrity import check_object_bytes, object_table
from codec.stream.manifest import Manifest, Part
from codec.stream.object import ENTRY, HEAD, ChunkEntry, error_in_object

MARGIN = 1.1
"""Before the table of an object is here: bytes asked for as a share of what the packets take in
the mean. What is too much of one packet is the beginning of the next one."""

SKIP_BYTES = 32 << 10
"""Rather than to wait for the table, to find what begins behind so many bytes, these are taken
too: about what a link of 10 Mbit/s carries in the time."""

REST_BYTES = 8 << 10
"""If less than this would be left of an object, the rest is requested too: masks come whole."""


class PartialObject:
    """The object of one part of a segment."""

    def __init__(self, manifest: Manifest, record: SegmentRecord, part: Part) -> None:
        """Raises CorruptError if by the index there can be no such object."""
        self._manifest, self._record, self.part = manifest, record, part
        self._number = manifest.part_number(part)
        self.name = ""
        """Where its bytes come from: what errors name."""
        self.births = manifest.part_births(record.segment, record.num_frames, part)
        self.num_bytes = record.part_bytes[self._number]
        if self.num_bytes < HEAD.size:
            message = f"object: the index says {self.num_bytes} bytes, but its head alone is longer"
            raise CorruptError(message)
        self._table_bytes = min(self.num_bytes, HEAD.size + ENTRY.size * len(self.births))
        self._entries: dict[int, ChunkEntry] | None = None
        self._asked: list[range] = []  # in order, apart
        self._runs: list[tuple[int, bytearray]] = []  # what is here: (first byte, bytes), the same

    def ask(self, births: range, whole: bool = False) -> range | None:
        """The bytes to ask for so that the packets of `births` come; None if there are none, or if
        what was asked for must come first. whole: or else all bytes of the object."""
        if whole:
            return self._add_asked(0, self.num_bytes) if not self._asked else None
        if self._entries is not None:
            found = [self._entries[birth] for birth in births if birth in self._entries]
            if not found:
                return None
            return self._add_asked(found[0].offset, self._end(found[-1].offset + found[-1].size))
        if self._asked:
            return None
        mean_bytes = (self.num_bytes - self._table_bytes) / len(self.births)
        if (births.start - self.births.start) * mean_bytes > SKIP_BYTES:
            return self._add_asked(0, self._table_bytes)
        count = births.stop - self.births.start
        end = self._table_bytes + math.ceil(MARGIN * mean_bytes * count)
        return self._add_asked(0, self._end(end))

    def _end(self, end: int) -> int:
        """Where bytes end that are asked for up to `end` at least."""
        return end if end + REST_BYTES < self.num_bytes else self.num_bytes

    @property
    def is_settled(self) -> bool:
        """Whether nothing that is wanted of it has to wait for its table."""
        return self._entries is not None or self._asked == [range(self.num_bytes)]

    def _add_asked(self, first: int, end: int) -> range | None:
        """Notes what is new of first..end-1 as asked for; gives it, with what is between."""
        for run in self._asked:
            if run.start <= first < run.stop:
                first = run.stop
        for run in reversed(self._asked):
            if run.start < end <= run.stop:
                end = run.start
        if first >= end:
            return None
        self._asked.append(range(first, end))
        self._asked.sort(key=lambda run: run.start)
        return range(first, end)

    def all_comes(self) -> None:
        """The host sends the whole object."""
        self._asked = [range(self.num_bytes)]

    def add(self, first_byte: int, data: bytes) -> None:
        """Takes in bytes that have come; they may be here already. Raises a CodecError that names
        the object."""
        runs = self._runs
        at = bisect_right(runs, first_byte, key=lambda run: run[0]) - 1
        if at >= 0 and first_byte <= runs[at][0] + len(runs[at][1]):
            start, run = runs[at]
            run += data[start + len(run) - first_byte :]
        else:
            at += 1
            start, run = first_byte, bytearray(data)
            runs.insert(at, (start, run))
        while at + 1 < len(runs) and runs[at + 1][0] <= start + len(run):
            next_start, following = runs.pop(at + 1)
            run += following[start + len(run) - next_start :]
        if self._entries is None and not start and len(run) >= self._table_bytes:
            try:
                entries = object_table(bytes(run), self._manifest, self._record, self.part)
            except CodecError as error:
                raise error.within(self.name) from error
            self._entries = {entry.birth: entry for entry in entries}

    def packet(self, birth: int) -> bytes | None:
        """The packet of the slice born at `birth`, no bytes if that changes nothing; None while it
        is not here."""
        if not self.has(birth):
            return None
        entry = (self._entries or {}).get(birth)
        if entry is None:
            return b""
        start, run = self._run(entry.offset)
        return bytes(run[entry.offset - start : entry.offset - start + entry.size])

    def has(self, birth: int) -> bool:
        """Whether the packet of the slice born at `birth` is here."""
        if self._entries is None:
            return False
        entry = self._entries.get(birth)
        if entry is None:
            return True
        start, run = self._run(entry.offset)
        return entry.offset + entry.size <= start + len(run)

    def _run(self, at_byte: int) -> tuple[int, bytearray]:
        """The last run of what is here that begins at or before `at_byte`; that of the table
        does."""
        return self._runs[bisect_right(self._runs, at_byte, key=lambda run: run[0]) - 1]

    def whole(self) -> bytes | None:
        """All its bytes, as the index says they are; None while some are not here. Raises a
        CodecError that names the object."""
        if not self._runs or self._runs[0][0] or len(self._runs[0][1]) != self.num_bytes:
            return None
        data = bytes(self._runs[0][1])
        try:
            check_object_bytes(data, self._record, self._number)
        except CodecError as error:
            raise error.within(self.name) from error
        return data

    def blamed(self, error: CodecError, birth: int) -> CodecError:
        """`error`, whose place is one in the chunk of `birth`, as one that names the object."""
        entry = (self._entries or {}).get(birth)
        if entry is None:
            return error.reworded(f"{self.name}: {error} (birth {birth})", None)
        return error_in_object(error, entry).within(self.name)
