"""Requests and packets of an adaptive play from a static host: the server's part, done here; and an
object that comes in pieces.

Rule: no network and no clock. Times and bytes come in; runs of bytes to ask for, and packets, go
out. A request is made before the one before it has been answered: the link has no time to rest.
What was asked for comes, or the play ends: nothing is asked for twice.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

from codec.errors import CodecError, CorruptError
from codec.framerange import FrameRange
from codec.stream.integrity import check_object_bytes, object_table
from codec.stream.manifest import SKIP_MAPS, Manifest, Part, is_keyframe, keyframe_part
from codec.stream.segment import ENTRY, OBJECT_HEAD, ChunkEntry, SegmentRecord, error_in_object
from server.abr.clientstatus import ClientStatus
from server.abr.decisioncontext import Send, SendKeyframes, SendSlices
from server.abr.media import RecordedMedia
from server.abr.session import (
    Finished,
    PlaySession,
    SessionConfig,
    WaitForAck,
    WaitForFrames,
    WaitUntil,
)
from server.abr.sweep import Sweep

from .source import Blame, KeyframePackets, Packets, SlicePackets

MARGIN = 1.1
"""Before the table of an object is here: bytes asked for as a share of what the packets take in
the mean. What is too much of one packet is the beginning of the next one."""

SKIP_BYTES = 32 << 10
"""Rather than to wait for the table, to find what begins behind so many bytes, these are taken
too: about what a link of 10 Mbit/s carries in the time."""

REST_BYTES = 8 << 10
"""If less than this would be left of an object, the rest is requested too: skip maps come whole."""


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
        if self.num_bytes < OBJECT_HEAD.size:
            message = f"object: the index says {self.num_bytes} bytes, but its head alone is longer"
            raise CorruptError(message)
        self._table_bytes = min(self.num_bytes, OBJECT_HEAD.size + ENTRY.size * len(self.births))
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


SESSION = SessionConfig(run_s=0.1, queue_s=0.04, first_bytes=16 << 10)
"""As a server's, but each request costs something: it fills more of the link. As that is on its way
then, too, less may be before it on a slow one."""

MOST_ASKS = 3
MOST_FAR_ASKS = 8
"""So many requests may be open, each on a connection of its own, before another one is made: they
share the link, and what is needed first comes later. Far away, where objects are shorter than the
round trip, more of them fill the link."""

STANDS_STILL = 3
"""So many reports of a picture that waits for data make a link too slow, if it carries less than
layer 0."""

ASK_S = 0.04
"""The round trip for which there is one request more, seconds."""


@dataclass(slots=True, eq=False)
class Ask:
    """A request for a run of bytes of an object."""

    segment: int
    part: Part
    first_byte: int
    end_byte: int
    come_bytes: int = 0

    @property
    def num_bytes(self) -> int:
        return self.end_byte - self.first_byte


Wait = WaitForAck | WaitUntil | WaitForFrames | Finished


@dataclass(slots=True, eq=False)
class _Wanted:
    """Chosen packets of one layer of one segment, on their way."""

    send: Send
    segment: int
    parts: tuple[Part, ...]
    """All that one of its slices, or keyframes, needs."""
    layer: int
    births: range
    """Births that have not been handed over; of keyframes their frame."""
    asks: list[Ask] = field(default_factory=list)
    """Requests that are not fully answered."""


class HostedPlay:
    """One play of a hosted stream whose layers are chosen by how fast they come."""

    def __init__(
        self,
        manifest: Manifest,
        records: Sequence[SegmentRecord],
        frames: FrameRange,
        now_s: float,
        rate_bps: float | None = None,
    ) -> None:
        """records: of the index, which may grow. rate_bps: what the link is known to carry."""
        self._records, self._frames = records, frames
        self._began_s = now_s
        self.media = RecordedMedia(manifest, records)
        self.session = PlaySession(
            self.media, Sweep(), SESSION, now_s, frames.first, frames.end, rate_bps
        )
        self.knows_ranges = True
        """Whether the host sends less than the whole of an object; False once it did not."""
        self._pieces: dict[tuple[int, Part], PartialObject] = {}
        self._given: dict[tuple[int, Part], set[int]] = {}
        """Births that were chosen, by segment and part: none is handed over twice."""
        self._lost: set[tuple[int, int]] = set()
        """Layers that segments lack, as the host lacks or has damaged an object: (segment,
        layer)."""
        self._wanted: list[_Wanted] = []
        """In the order in which it was chosen."""
        self._chosen: list[Send] = []
        """Decisions of the session, of one segment each, that were not requested yet."""
        self._unsent: deque[Ask] = deque()
        self._stood_still = 0
        self._ended_bytes = 0
        """Bytes of requests that were answered whole."""

    @property
    def _open_asks(self) -> list[Ask]:
        return [ask for wanted in self._wanted for ask in wanted.asks]

    @property
    def _most_asks(self) -> int:
        latency_s = self.session.least_latency_s or 0.0
        return min(MOST_FAR_ASKS, MOST_ASKS + int(latency_s / ASK_S))

    def next(self, now_s: float) -> Ask | Wait:
        """The next request, or what to wait for: WaitForAck means an open request. Raises a
        CodecError."""
        session = self.session
        come_bytes = sum(ask.come_bytes for ask in self._open_asks)
        session.acknowledge(now_s, self._ended_bytes + come_bytes)
        while True:
            for wanted in self._wanted:
                if num_bytes := self._ask(wanted):
                    session.sent(wanted.send, num_bytes, now_s)  # it is known now where it lies
            if self._unsent:
                return self._unsent.popleft()
            # Nor is more chosen before it is known where all lies that was.
            if len(self._open_asks) >= self._most_asks or any(map(self._lacks, self._wanted)):
                return WaitForAck()
            if not self._chosen:
                if self._would_delay_the_start(now_s):
                    return WaitForAck()
                decision = session.decide(now_s)
                if not isinstance(decision, SendSlices | SendKeyframes):
                    return decision
                self._forget()
                self._chosen = self._by_segment(decision)
            self._want(self._chosen.pop(0), now_s)

    def note_status(self, now_s: float, status: ClientStatus) -> str:
        """Applies a status report of the player. Gives what to tell the viewer of a link that is
        too slow, once; else nothing."""
        self.session.on_status(now_s, status)
        rate_bps, media = self.session.rate_bps, self.media
        if rate_bps is None or status.paused or status.buffer_s != 0.0 or not media.num_frames:
            return ""
        frame = min(status.frame or 0, media.num_frames - 1)
        need_bps = 8 * media.fps * media.sizes(frame).layer_bytes[0]
        if rate_bps >= need_bps:
            return ""
        self._stood_still += 1
        if self._stood_still != STANDS_STILL:
            return ""
        carried, needed = (f"{bps / 1e6:.2g}" for bps in (rate_bps, need_bps))
        return f"this connection carries {carried} of the {needed} Mbit/s that this video needs"

    def _would_delay_the_start(self, now_s: float) -> bool:
        """Whether another request would take too much of the link from those that the first picture
        waits for. The first estimates of a rate are too wild to tell; the mean is not."""
        session = self.session
        if session.clock.started_s is not None or session.least_latency_s is None:
            return False
        held_s = session.least_latency_s + SESSION.queue_s
        return session.queued_bytes * (now_s - self._began_s) > session.acked_bytes * held_s

    def _want(self, send: Send, now_s: float) -> None:
        """Asks for what was chosen of one segment."""
        manifest, num_bytes = self.media.manifest, 0
        births = send.births if isinstance(send, SendSlices) else range(send.frame, send.frame + 1)
        segment = manifest.segment_of(births[0])
        for layer in range(send.first_layer, send.end_layer):
            parts: tuple[Part, ...] = (layer,)
            if isinstance(send, SendKeyframes):
                parts = (keyframe_part(layer),)
            elif layer == 0:
                parts = (SKIP_MAPS, layer)
            fresh = self._fresh(segment, parts[-1], births)
            if (segment, layer) in self._lost:
                continue  # the session need not know: the next segment comes with its keyframe
            if (segment - 1, layer) in self._lost and isinstance(send, SendSlices):
                num_bytes += self._want_keyframe(segment, layer)
            for run in fresh:
                wanted = _Wanted(send, segment, parts, layer, run)
                self._wanted.append(wanted)
                num_bytes += self._ask(wanted)
        # It hears of what is here or underway already, too: that was chosen.
        self.session.sent(send, num_bytes, now_s)

    def _want_keyframe(self, segment: int, layer: int) -> int:
        """Asks for the keyframe of a layer, unless it was chosen before; gives its bytes."""
        frame, part = self._records[segment].first_frame, keyframe_part(layer)
        num_bytes = 0
        for births in self._fresh(segment, part, range(frame, frame + 1)):
            send = SendKeyframes(frame, layer, layer + 1)
            wanted = _Wanted(send, segment, (part,), layer, births)
            self._wanted.insert(0, wanted)  # before the changes that need it
            num_bytes += self._ask(wanted)
        return num_bytes

    def lose(self, segment: int, layer: int, now_s: float) -> list[Ask]:
        """Goes on without a layer above 0 of a segment; the next one begins with its keyframe.
        Gives the requests that are not needed any more. Raises a CodecError."""
        self._lost.add((segment, layer))
        lost = [one for one in self._wanted if (one.segment, one.layer) == (segment, layer)]
        self._wanted = [one for one in self._wanted if one not in lost]
        asks = [ask for wanted in lost for ask in wanted.asks]
        self._unsent = deque(ask for ask in self._unsent if ask not in asks)
        come_bytes = sum(ask.come_bytes for ask in asks)
        self._ended_bytes += come_bytes
        self.session.lost(sum(ask.num_bytes for ask in asks) - come_bytes)
        if self._given.get((segment + 1, layer)):
            send = SendKeyframes(self._records[segment + 1].first_frame, layer, layer + 1)
            self.session.sent(send, self._want_keyframe(segment + 1, layer), now_s)
        return asks

    def _by_segment(self, send: Send) -> list[Send]:
        """The decision, segment by segment: simultaneous requests share the link, and later
        segments can wait."""
        if not isinstance(send, SendSlices):
            return [send]
        found: list[Send] = []
        first = send.births.start
        while first < send.births.stop:
            record = self._records[self.media.manifest.segment_of(first)]
            record_end = end = record.first_frame + record.num_frames
            if self.knows_ranges:
                end = min(end, send.births.stop)
            elif self._frames.end is not None:
                end = min(end, self._frames.end)  # whole objects
            found.append(replace(send, births=range(first, end)))
            first = record_end
        return found

    def _fresh(self, segment: int, part: Part, births: range) -> list[range]:
        """Runs of `births` in the segment that were not chosen before."""
        record = self._records[segment]
        own = self.media.manifest.part_births(segment, record.num_frames, part)
        given = self._given.setdefault((segment, part), set())
        runs: list[range] = []
        for birth in range(max(births.start, own.start), min(births.stop, own.stop)):
            if birth in given:
                continue
            given.add(birth)
            if runs and runs[-1].stop == birth:
                runs[-1] = range(runs[-1].start, birth + 1)
            else:
                runs.append(range(birth, birth + 1))
        return runs

    def _lacks(self, wanted: _Wanted) -> bool:
        """Whether something of it could not be asked for yet."""
        asked = {ask.part for ask in wanted.asks}
        return any(
            part not in asked and not self._object(wanted.segment, part).is_settled
            for part in wanted.parts
        )

    def _ask(self, wanted: _Wanted) -> int:
        """Makes the requests for what `wanted` lacks, as far as is known where that lies; gives
        their bytes."""
        num_bytes = 0
        for part in wanted.parts:
            pieces = self._object(wanted.segment, part)
            if all(map(pieces.has, wanted.births)):
                continue
            run = pieces.ask(wanted.births, whole=not self.knows_ranges)
            if run is not None:
                ask = Ask(wanted.segment, part, run.start, run.stop)
                wanted.asks.append(ask)
                self._unsent.append(ask)
                num_bytes += ask.num_bytes
        return num_bytes

    def _object(self, segment: int, part: Part) -> PartialObject:
        key = segment, part
        found = self._pieces.get(key)
        if found is None:
            manifest = self.media.manifest
            found = self._pieces[key] = PartialObject(manifest, self._records[segment], part)
        return found

    def comes_whole(self, ask: Ask, now_s: float) -> None:
        """The host answers `ask` with the whole object."""
        pieces = self._object(ask.segment, ask.part)
        more_bytes = pieces.num_bytes - ask.num_bytes
        if not more_bytes:
            return
        self.knows_ranges = False
        wanted = next(one for one in self._wanted if ask in one.asks)
        ask.first_byte, ask.end_byte = 0, pieces.num_bytes
        pieces.all_comes()
        self.session.sent(wanted.send, more_bytes, now_s)
        self._chosen = self._by_segment(wanted.send) + self._chosen

    def come(self, ask: Ask, url: str, first_byte: int, data: bytes) -> None:
        """Bytes of the object came from `url`. Raises a CodecError that names it."""
        pieces = self._object(ask.segment, ask.part)
        pieces.name = url
        pieces.add(first_byte, data)
        ask.come_bytes = max(ask.come_bytes, first_byte + len(data) - ask.first_byte)

    def ended(self, ask: Ask) -> None:
        """All of it has come. Raises a CodecError that names an object that is not the one of the
        index."""
        wanted = next(one for one in self._wanted if ask in one.asks)
        wanted.asks.remove(ask)
        self._ended_bytes += ask.num_bytes
        pieces = self._object(ask.segment, ask.part)
        pieces.whole()  # checks it

    def packets(self) -> Iterator[Packets]:
        """Packets that have arrived and were not handed over: of each layer in the order of choice,
        as a keyframe comes before its changes."""
        behind: set[int] = set()  # layers of which something is to come first
        for wanted in list(self._wanted):
            if wanted.layer not in behind:
                yield from self._complete(wanted)
            if wanted.births:
                behind.add(wanted.layer)
            elif not wanted.asks:
                self._wanted.remove(wanted)

    def _complete(self, wanted: _Wanted) -> Iterator[Packets]:
        """Packets of `wanted` that have arrived."""
        objects = {part: self._object(wanted.segment, part) for part in wanted.parts}
        while wanted.births:
            birth = wanted.births[0]
            found = [pieces.packet(birth) for pieces in objects.values()]
            if None in found:
                return
            wanted.births = wanted.births[1:]
            *skip_maps, packet = (one or b"" for one in found)
            blame = _blame(objects, birth)
            if is_keyframe(wanted.parts[-1]):
                yield KeyframePackets(birth, wanted.layer, (packet,), blame)
            else:
                skip_map = skip_maps[0] if skip_maps else None
                yield SlicePackets(birth, wanted.layer, (packet,), skip_map, blame)

    def _forget(self) -> None:
        """Drops what is here of segments of which nothing shows any more."""
        oldest = self.session.next_frame - self.media.manifest.swin_size + 1
        segment = self.media.manifest.segment_of(oldest)
        segment = min([segment, *(wanted.segment for wanted in self._wanted)])
        for key in [key for key in self._pieces if key[0] < segment]:
            del self._pieces[key]
        for key in [key for key in self._given if key[0] < segment]:
            del self._given[key]
        self._lost = {lost for lost in self._lost if lost[0] >= segment - 1}


def _blame(objects: dict[Part, PartialObject], birth: int) -> Blame:
    """Makes an error name the object of a segment that is at fault."""

    def blame(error: CodecError, part: Part) -> CodecError:
        return objects[part].blamed(error, birth)

    return blame
