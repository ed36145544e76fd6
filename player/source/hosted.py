"""A stream on any static host: manifest, index and objects fetched one by one."""

from __future__ import annotations

import random
import time
from collections.abc import Iterator
from urllib.parse import urljoin

from codec.errors import CodecError
from codec.framerange import FrameRange
from codec.stream.index import INDEX_NAME, SegmentRecord
from codec.stream.integrity import MAX_INDEX_BYTES, CheckedObject, read_index
from codec.stream.manifest import MANIFEST_NAME, MAX_MANIFEST_BYTES, Manifest, Part
from server.abr.standing import Standing

from .bounds import Bounds
from .fetch import BrokenError, Fetcher, FetchError
from .hosts import joined
from .lastplay import NO_PLAY
from .retry import Retry, RetryConfig
from .segments import SegmentPlay
from .source import Packets, check_frames, check_layers


def fetch_manifest(fetcher: Fetcher, url: str) -> tuple[Manifest, str] | None:
    """The manifest at `url`, and the URL of the folder that it was found in, with a slash; None if
    there is nothing. Raises FetchError for anything else."""
    response = fetcher.get(url, MAX_MANIFEST_BYTES)
    if response.status in (404, 410):
        return None
    if response.status != 200:
        raise FetchError(f"{url} is not a stream: HTTP {response.status}")
    try:
        return Manifest.from_json(response.body), urljoin(response.url, ".")
    except CodecError as error:
        raise FetchError(f"{error.within(url)}; this is not a stream") from error


class HostedSource:
    """A stream whose files lie under the URL `base`.

    One that is still written is played as far as its index had come when it was opened.
    """

    def __init__(
        self,
        name: str,
        base: str,
        manifest: Manifest,
        fetcher: Fetcher,
        frames: FrameRange,
        layers: int | None,
        retry: RetryConfig | None = None,
    ) -> None:
        """base: ends with a slash. fetcher: is closed together with the source."""
        self.name = name
        self.manifest = manifest
        self._base = base
        self._fetcher = fetcher
        self._retry = retry or RetryConfig()
        self.play = NO_PLAY
        self.adaptive = False
        self.num_layers = check_layers(layers, manifest, name)
        self._records = self._read_index()
        last = self._records[-1] if self._records else None
        num_frames = last.first_frame + last.num_frames if last else 0
        finished = manifest.with_live(False)
        self.frames = check_frames(frames, finished, num_frames, name)

    @property
    def received_bytes(self) -> int:
        return self._fetcher.received_bytes

    def _read_index(self) -> list[SegmentRecord]:
        url = self._base + INDEX_NAME
        try:
            records = read_index(self._get(url, MAX_INDEX_BYTES), self.manifest)
            bounds = Bounds(self.manifest)
            for record in records:
                bounds.check_segment(record)
            return records
        except CodecError as error:
            raise error.within(url) from error

    def _get(self, url: str, limit_bytes: int) -> bytes:
        """The body at `url`, asked for again while the connection breaks."""
        retry = Retry(self._retry)
        while True:
            try:
                response = self._fetcher.get(url, limit_bytes)
                if response.status == 200:
                    return response.body
                if response.status < 500 and response.status != 429:
                    raise FetchError(f"{url}: HTTP {response.status}")
                raise BrokenError(f"{url}: HTTP {response.status}", response.retry_after_s)
            except BrokenError as error:
                now_s = time.monotonic()
                self._fetcher.pause(retry.delay_s(error, now_s, random.random()))

    def _object(self, record: SegmentRecord, part: Part) -> CheckedObject:
        manifest = self.manifest
        url = joined(
            self._base + MANIFEST_NAME,
            manifest.object_path(record.segment, part),
            self._fetcher.config.other_hosts,
        )
        data = self._get(url, record.part_bytes[manifest.part_number(part)])
        return CheckedObject.check(url, data, manifest, record, part)

    def packets(self) -> Iterator[Packets]:
        # Its frames have an end: a hosted stream is opened as finished.
        play = SegmentPlay(self.manifest, self.num_layers, self.frames)
        while (segment := play.segment) is not None:
            record = self._records[segment]
            yield from play.packets({part: self._object(record, part) for part in play.parts})

    def tell(self, standing: Standing) -> bool:
        return False

    def interrupt(self) -> None:
        self._fetcher.interrupt()

    def close(self) -> None:
        self._fetcher.close()
