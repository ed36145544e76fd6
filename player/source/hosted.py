"""A stream on any static host: manifest, index and objects fetched one by one."""

from __future__ import annotations

import hashlib
import logging
import time
from collections.abc import Iterator
from dataclasses import dataclass
from urllib.parse import urljoin

from codec.errors import CodecError, CorruptError
from codec.framerange import FrameRange
from codec.stream.index import SegmentRecord
from codec.stream.integrity import CheckedObject
from codec.stream.manifest import MANIFEST_NAME, MAX_MANIFEST_BYTES, Manifest, Part
from player.network.diskcache import DiskCache
from player.network.faults import BrokenError, FetchError
from player.network.fetch import Fetcher
from player.network.idle import IdleLimit
from player.network.mirrors import Mirrors, refusal
from player.network.retry import RetryConfig
from server.abr.standing import Standing

from .hostedindex import REPLACED, HostedIndex
from .lastplay import NO_PLAY
from .segments import SegmentPlay
from .source import Packets, check_frames, check_layers

log = logging.getLogger(__name__)

WAIT_S = 20
"""Seconds for which a server that can may wait for a segment before it answers."""

MAX_POLL_S = 5.0
"""Longest time between two looks at the index where the server cannot wait, seconds."""


@dataclass(frozen=True, slots=True)
class HostedPlace:
    """A stream on static hosts, and what is known of it."""

    bases: tuple[str, ...]
    """URLs of its folder on each host, with a slash at the end."""
    manifest: Manifest
    index: HostedIndex
    """Grows with what its sources read."""


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
        cache: DiskCache | None = None,
    ) -> None:
        """fetcher: is closed together with the source."""
        self.name = name
        self.manifest = place.manifest
        self._index = place.index
        self._fetcher = fetcher
        self._mirrors = Mirrors(place.bases, fetcher, retry or RetryConfig())
        self._cache = cache
        self.play = NO_PLAY
        self.adaptive = False
        self.num_layers = check_layers(layers, self.manifest, name)
        if not self._index.records:
            self._index.grow(self._mirrors)
        self.frames = check_frames(frames, self.manifest, self._index.num_frames, name)

    @property
    def num_frames(self) -> int:
        return self._index.num_frames

    @property
    def received_bytes(self) -> int:
        return self._fetcher.received_bytes

    def _object(self, record: SegmentRecord, part: Part) -> CheckedObject:
        manifest = self.manifest
        number = manifest.part_number(part)
        reference = manifest.object_path(record.segment, part)
        sha256, size = record.part_sha256[number], record.part_bytes[number]
        kept = self._cache.get(sha256) if self._cache else None
        if kept is not None:
            return CheckedObject.check(self._mirrors.url(reference), kept, manifest, record, part)
        found = self._mirrors.get(reference, size)
        if found.pieced and hashlib.sha256(found.data).digest() != sha256:
            # Two answers that do not belong together; who gives one whole gets no other chance.
            found = self._mirrors.get(reference, size)
        data = bytes(found.data)
        try:
            checked = CheckedObject.check(found.url, data, manifest, record, part)
        except CorruptError as error:
            if self._index.is_replaced(self._mirrors):
                raise CorruptError(f"{self.name}: {REPLACED}") from error
            raise
        if self._cache:
            self._cache.put(sha256, data)
        return checked

    def packets(self) -> Iterator[Packets]:
        play = SegmentPlay(self.manifest, self.num_layers, self.frames)
        while (segment := play.segment) is not None:
            if segment >= len(self._index.records) and not self._follow():
                return
            if segment < len(self._index.records):
                record = self._index.records[segment]
                yield from play.packets({part: self._object(record, part) for part in play.parts})

    def _follow(self) -> bool:
        """Waits for the index to grow; gives whether there may be more."""
        poll_s = min(max(self.manifest.segment_frames / self.manifest.fps / 4, 0.2), MAX_POLL_S)
        idle_s = self._fetcher.config.idle_s
        idle = IdleLimit(idle_s, time.monotonic())
        while self.manifest.live:
            began_s = time.monotonic()
            if self._index.grow(self._mirrors, WAIT_S):
                return True
            self._read_manifest()
            if not self.manifest.live:
                return self._index.grow(self._mirrors)
            if not idle.left_s(time.monotonic()):
                log.warning(
                    "%s: no new frames for %.0f s; it ends here",
                    self.name,
                    self._fetcher.config.idle_s,
                )
                return False
            # A host that knows no `wait` has answered at once.
            if time.monotonic() - began_s < poll_s:
                self._fetcher.pause(poll_s)
        return False

    def _read_manifest(self) -> None:
        found = self._mirrors.get(MANIFEST_NAME, MAX_MANIFEST_BYTES)
        try:
            manifest = Manifest.from_json(bytes(found.data))
        except CodecError as error:
            raise error.within(found.url) from error
        if manifest.with_live(False).to_json() != self.manifest.with_live(False).to_json():
            raise CorruptError(f"{self.name}: {REPLACED}")
        self.manifest = manifest

    def tell(self, standing: Standing) -> bool:
        return False

    def interrupt(self) -> None:
        self._fetcher.interrupt()

    def close(self) -> None:
        self._fetcher.close()
