"""A stream on any static host: manifest, objects and an index that may still grow, fetched one by
one, or as parts of the one file of a packed stream.
"""

from __future__ import annotations

import hashlib
import logging
import math
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from urllib.parse import urljoin

from codec.errors import CodecError, CorruptError, SwingsError
from codec.framerange import FrameRange
from codec.stream.integrity import CheckedObject, read_index
from codec.stream.manifest import (
    MANIFEST_NAME,
    MAX_MANIFEST_BYTES,
    Manifest,
    Part,
    layer_of,
    object_name,
)
from codec.stream.packedlayout import PackedLayout, read_layout
from codec.stream.segment import INDEX_NAME, SegmentRecord, record_bytes
from player.network.fetch import Fetcher, RetryConfig
from player.network.http import IdleLimit
from player.network.mirrors import Extent, Mirrors, Span, check_range, refusal
from player.network.target import BrokenError, FetchError, MissingError
from server.abr.clientstatus import ClientStatus
from server.abr.session import Finished, WaitForFrames, WaitUntil

from .directory import SegmentReader
from .hostedplay import Ask, HostedPlay, Wait
from .sizelimits import SizeLimits
from .source import REPORT_S, LastPlay, Packets, check_frames, check_layers

MAX_HOSTED_INDEX_BYTES = 1 << 26
"""Longest index read: its records take about six times as much in memory."""

REPLACED = "the stream was replaced by another one; play it again"


class HostedIndex:
    """The records that are known; the first ones never change."""

    def __init__(self, manifest: Manifest) -> None:
        self._manifest = manifest
        self._limits = SizeLimits(manifest)
        self._record_bytes = record_bytes(manifest.num_layers)
        self._last = b""
        self.records: list[SegmentRecord] = []

    @property
    def num_frames(self) -> int:
        last = self.records[-1] if self.records else None
        return last.first_frame + last.num_frames if last else 0

    def grow(self, mirrors: Mirrors, wait_s: int = 0) -> bool:
        """Gets what is new; gives whether something was. wait_s: for how long a server that can
        may wait for something new. Raises CorruptError when it is another stream's index."""
        known = len(self.records) * self._record_bytes
        overlap = len(self._last)
        reference = f"{INDEX_NAME}?after={known}&wait={wait_s}" if wait_s else INDEX_NAME
        limit_bytes = MAX_HOSTED_INDEX_BYTES
        if not known and not wait_s:
            data = bytes(mirrors.get(reference, limit_bytes).data)
        else:
            data = mirrors.tail(reference, known - overlap, limit_bytes)
        url = mirrors.url(INDEX_NAME)
        # Nothing at all is a host that lags behind another one.
        if data[:overlap] != self._last and len(data) >= overlap:
            raise CorruptError(f"{url}: {REPLACED}")
        return self.add(data[overlap:], url)

    def add(self, new: bytes, url: str) -> bool:
        """Takes in what follows on the records that are known, found at `url`; gives whether there
        is a record in it. Raises a CodecError."""
        known = len(self.records) * self._record_bytes
        try:
            records = read_index(new, self._manifest, self.records)
            for record in records:
                self._limits.check_segment(record)
        except CodecError as error:
            raise error.within(url, known) from error
        if records:
            end = len(records) * self._record_bytes
            self._last = new[end - self._record_bytes : end]
            self.records += records
        return bool(records)

    def is_replaced(self, mirrors: Mirrors) -> bool:
        """Whether the host has another stream by now."""
        if not self.records:
            return False
        at = (len(self.records) - 1) * self._record_bytes
        return mirrors.tail(INDEX_NAME, at, MAX_HOSTED_INDEX_BYTES)[: len(self._last)] != self._last


log = logging.getLogger(__name__)

WAIT_S = 20
"""Seconds for which a server that can may wait for a segment before it answers."""

MAX_POLL_S = 5.0
"""Longest time between two looks at the index where the server cannot wait, seconds."""


LOOK_S = 0.1
"""How often it is looked, at least, what is worth asking for and what the player says, seconds."""


@dataclass(frozen=True, slots=True)
class HostedPlace:
    """A stream on static hosts, and what is known of it."""

    bases: tuple[str, ...]
    """URLs of its folder on each host, with a slash at the end; of a packed stream, of its file."""
    manifest: Manifest
    index: HostedIndex
    """Grows with what its sources read."""
    layout: PackedLayout | None = None
    """The layout of a packed stream; None for a folder."""

    def mirrors(self, fetcher: Fetcher, retry: RetryConfig) -> Mirrors:
        """Its hosts, to fetch its files from."""
        return Mirrors(self.bases, fetcher, retry, None if self.layout is None else self._find)

    def _find(self, path: str) -> Extent:
        assert self.layout is not None
        found = self.layout.find(path)
        if found is None:
            raise MissingError(f"{self.bases[0]} has no {path}")
        return Extent(*found, self.layout.size_bytes)

    def reference(self, segment: int, part: Part) -> str:
        """The name of an object there."""
        if self.layout is not None:
            return object_name(segment, part)
        return self.manifest.object_path(segment, part)


def fetch_manifest(fetcher: Fetcher, url: str) -> tuple[Manifest, str] | None:
    """The manifest at `url`, and the URL of the folder that it was found in, with a slash; None if
    there is nothing. Raises FetchError for anything else."""
    response = fetcher.get(url, MAX_MANIFEST_BYTES)
    if response.status in (404, 410):
        return None
    if response.status != 200:
        error = refusal(url, response)
        if isinstance(error, BrokenError):
            raise error
        raise FetchError(f"{url} is not a stream: HTTP {response.status}")
    try:
        return Manifest.from_json(response.body), urljoin(response.url, ".")
    except CodecError as error:
        raise FetchError(f"{error.within(url)}; this is not a stream") from error


def fetch_packed(fetcher: Fetcher, url: str) -> HostedPlace:
    """The packed stream at `url`, by one request or two. Raises FetchError."""
    read, place = bytearray(), url

    def read_more(offset: int, most_bytes: int) -> tuple[bytes, int]:
        nonlocal place
        assert offset == len(read)
        data, file_bytes, place = fetch_range(fetcher, place, offset, most_bytes)
        read.extend(data)
        return data, file_bytes

    try:
        layout = read_layout(read_more, MAX_HOSTED_INDEX_BYTES)
    except CodecError as error:
        raise FetchError(f"{error.within(url)}; this is not a stream") from error
    index = HostedIndex(layout.manifest)
    index.add(bytes(read[layout.head.index_at : layout.head.index_end]), url)
    return HostedPlace((place,), layout.manifest, index, layout)


def fetch_range(fetcher: Fetcher, url: str, offset: int, most_bytes: int) -> tuple[bytes, int, str]:
    """The bytes of the file at `url` from `offset` on, so many at most and fewer only at its end;
    the size of the file; and where redirects have led. Raises FetchError."""
    asked = {"Range": f"bytes={offset}-{offset + most_bytes - 1}"}
    with closing(fetcher.open(url, asked)) as response:
        file_bytes = check_range(response, offset)
        data = response.rest(most_bytes)
        if len(data) != min(most_bytes, file_bytes - offset):
            raise BrokenError(f"{url}: the response ended early")
        return data, file_bytes, response.url


class HostedSource:
    """A stream whose files lie under URLs; one that is still written is followed."""

    def __init__(
        self,
        name: str,
        place: HostedPlace,
        fetcher: Fetcher,
        frames: FrameRange,
        layers: int | None,
        retry: RetryConfig | None = None,
        adaptive: bool = False,
        rate_bps: float | None = None,
    ) -> None:
        """fetcher: is closed together with the source. adaptive: layers may come late or not at
        all, as the link allows. rate_bps: what that carried at the last play."""
        self.name = name
        self.manifest = place.manifest
        self._index = place.index
        self._fetcher = fetcher
        self._reference = place.reference
        self._is_packed = place.layout is not None
        self._mirrors = place.mirrors(fetcher, retry or RetryConfig())
        self.adaptive = adaptive
        self._rate_bps = rate_bps
        self._play: HostedPlay | None = None
        self._status: ClientStatus | None = None
        self.num_layers = check_layers(layers, self.manifest, name)
        if not self._index.records:
            self._index.grow(self._mirrors)
        self.frames = check_frames(frames, self.manifest, self._index.num_frames, name)

    @property
    def play(self) -> LastPlay:
        found = self._play.session.rate_bps if self._play else None
        return LastPlay(rate_bps=found or self._rate_bps)

    @property
    def num_frames(self) -> int:
        return self._index.num_frames

    @property
    def received_bytes(self) -> int:
        return self._fetcher.received_bytes

    def _object(self, record: SegmentRecord, part: Part) -> CheckedObject:
        manifest = self.manifest
        number = manifest.part_number(part)
        reference = self._reference(record.segment, part)
        sha256, size = record.part_sha256[number], record.part_bytes[number]
        try:
            found = self._mirrors.get(reference, size)
            if found.pieced and hashlib.sha256(found.data).digest() != sha256:
                # Its pieces do not belong together. A whole answer is not requested again.
                found = self._mirrors.get(reference, size)
            data = bytes(found.data)
            name = self._mirrors.name(reference) if self._is_packed else found.url
            return CheckedObject.check(name, data, manifest, record, part)
        except (FetchError, CorruptError) as error:
            raise self._explained(error) from error

    def packets(self) -> Iterator[Packets]:
        return self._chosen() if self.adaptive else self._all()

    def _all(self) -> Iterator[Packets]:
        """All layers, segment by segment."""
        play = SegmentReader(self.manifest, self.num_layers, self.frames)
        while (segment := play.segment) is not None:
            if segment >= len(self._index.records) and not self._follow():
                return
            if segment < len(self._index.records):
                record = self._index.records[segment]
                yield from play.packets({part: self._object(record, part) for part in play.parts})

    def _chosen(self) -> Iterator[Packets]:
        """The layers that the link can carry, those of the next frames first."""
        records, now_s = self._index.records, time.monotonic()
        self._play = play = HostedPlay(self.manifest, records, self.frames, now_s, self._rate_bps)
        open_spans: dict[Ask, Span] = {}
        look_s, idle = now_s + self._poll_s, IdleLimit(self._fetcher.config.idle_s, now_s)
        try:
            while True:
                self._hear(play)
                wait = self._ask(play, open_spans)
                yield from play.packets()
                if isinstance(wait, Finished) and not open_spans:
                    return
                until_s = wait.time_s if isinstance(wait, WaitUntil) else math.inf
                self._fetcher.wait(min(max(until_s - time.monotonic(), 0.0), LOOK_S))
                self._read_spans(play, open_spans)
                now_s = time.monotonic()
                if not isinstance(wait, WaitForFrames):
                    idle.useful(now_s)
                if not self.manifest.live or now_s < look_s:
                    continue
                if self._look():
                    idle.useful(time.monotonic())
                elif self.manifest.live and not idle.left_s(now_s):
                    self._warn()
                    return
                play.media.manifest = self.manifest
                look_s = time.monotonic() + self._poll_s
        except (FetchError, CorruptError) as error:
            raise self._explained(error) from error
        finally:
            # By the thread that reads: the next source may use the connections already.
            for span in open_spans.values():
                span.close()

    def _hear(self, play: HostedPlay) -> None:
        status, self._status = self._status, None
        if status is not None and (said := play.note_status(time.monotonic(), status)):
            log.warning("%s: %s", self.name, said)

    def _ask(self, play: HostedPlay, open_spans: dict[Ask, Span]) -> Wait:
        """Sends the requests that are worth it now."""
        while isinstance(ask := play.next(time.monotonic()), Ask):
            reference = self._reference(ask.segment, ask.part)
            number = self.manifest.part_number(ask.part)
            file_bytes = self._index.records[ask.segment].part_bytes[number]
            span = self._mirrors.span(reference, ask.first_byte, ask.end_byte, file_bytes)
            open_spans[ask] = span
        return ask

    def _read_spans(self, play: HostedPlay, open_spans: dict[Ask, Span]) -> None:
        """Takes in what has come."""
        for ask, span in list(open_spans.items()):
            if ask not in open_spans:
                continue  # its layer was lost meanwhile
            try:
                self._read_span(play, ask, span)
            except (FetchError, CodecError) as error:
                layer = layer_of(ask.part)
                if layer == 0:
                    raise
                log.warning("%s: layer %d of segment %d: %s", self.name, layer, ask.segment, error)
                for lost in {ask, *play.lose(ask.segment, layer, time.monotonic())}:
                    if lost in open_spans:
                        open_spans.pop(lost).close()
            else:
                if span.ended:
                    open_spans.pop(ask).close()

    def _read_span(self, play: HostedPlay, ask: Ask, span: Span) -> None:
        pieces = span.collect()
        if pieces and span.is_whole:
            play.comes_whole(ask, time.monotonic())
        for first_byte, data in pieces:
            play.come(ask, span.name, first_byte, data)
        if span.ended:
            play.ended(ask)

    def _explained(self, error: SwingsError) -> SwingsError:
        """Another error where the host has another stream by now."""
        if isinstance(error, BrokenError) or not self._index.is_replaced(self._mirrors):
            return error
        return CorruptError(f"{self.name}: {REPLACED}")

    @property
    def _poll_s(self) -> float:
        """Between two looks at the index of a live stream, seconds."""
        return min(max(self.manifest.segment_frames / self.manifest.fps / 4, 0.2), MAX_POLL_S)

    def _follow(self) -> bool:
        """Waits for the index to grow; gives whether there may be more."""
        idle_s = self._fetcher.config.idle_s
        idle = IdleLimit(idle_s, time.monotonic())
        while self.manifest.live:
            began_s = time.monotonic()
            if self._look(WAIT_S):
                return True
            if not self.manifest.live:
                return False
            if not idle.left_s(time.monotonic()):
                self._warn()
                return False
            # A host that knows no `wait` has answered at once.
            if time.monotonic() - began_s < self._poll_s:
                self._fetcher.pause(self._poll_s)
        return False

    def _look(self, wait_s: int = 0) -> bool:
        """Looks whether a live stream has grown, or has ended; gives whether there is more of
        it."""
        if self._index.grow(self._mirrors, wait_s):
            return True
        self._read_manifest()
        return not self.manifest.live and self._index.grow(self._mirrors)

    def _warn(self) -> None:
        idle_s = self._fetcher.config.idle_s
        log.warning("%s: no new frames for %.0f s; the play ends here", self.name, idle_s)

    def _read_manifest(self) -> None:
        found = self._mirrors.get(MANIFEST_NAME, MAX_MANIFEST_BYTES)
        try:
            manifest = Manifest.from_json(bytes(found.data))
        except CodecError as error:
            raise error.within(found.url) from error
        if not manifest.is_same_but_live(self.manifest):
            raise CorruptError(f"{self.name}: {REPLACED}")
        self.manifest = manifest

    @property
    def report_s(self) -> float:
        return REPORT_S

    def send_status(self, status: ClientStatus) -> bool:
        self._status = status
        return self.adaptive

    def interrupt(self) -> None:
        self._fetcher.interrupt()

    def close(self) -> None:
        self._fetcher.close()
