"""A stream on any static host: manifest, index and objects fetched one by one."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from urllib.parse import urljoin

from codec.errors import CodecError, CorruptError
from codec.framerange import FrameRange
from codec.stream.index import INDEX_NAME, SegmentRecord, parse_index, record_bytes
from codec.stream.manifest import MAX_MANIFEST_BYTES, Manifest
from codec.stream.object import MAX_OBJECT_BYTES
from player.playout.timeline import ReceivedSlice

from .decode import decode_segment
from .fetch import BrokenError, Fetcher, FetchError
from .retry import Retry, RetryConfig
from .source import check_frames, check_layers

MAX_INDEX_BYTES = 256 << 20
"""Longest index.bin read, bytes; that of a 100-hour stream has about 40 MB."""


def fetch_manifest(fetcher: Fetcher, url: str) -> Manifest | None:
    """The manifest at `url`; None when there is none. Raises FetchError when it is no manifest."""
    response = fetcher.get(url, MAX_MANIFEST_BYTES)
    if response.status in (404, 410):
        return None
    if response.status != 200:
        raise FetchError(f"{url} is not a stream: HTTP {response.status}")
    try:
        return Manifest.from_json(response.body)
    except CodecError as error:
        raise FetchError(f"{url} is not a stream: {error}") from error


class StaticHttpSource:
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
        self._name = name
        self._base = base
        self._manifest = manifest
        self._fetcher = fetcher
        self._retry = retry or RetryConfig()
        self._layers = check_layers(layers, manifest, name)
        self._records = self._read_index()
        last = self._records[-1] if self._records else None
        num_frames = last.first_frame + last.num_frames if last else 0
        finished = manifest.with_live(False)
        self._frames = check_frames(frames, finished, num_frames, name)

    def _read_index(self) -> list[SegmentRecord]:
        url, num_layers = urljoin(self._base, INDEX_NAME), self._manifest.num_layers
        data = self._get(url, MAX_INDEX_BYTES)
        try:
            records = parse_index(data, num_layers)
        except CodecError as error:
            raise error.within(url) from error
        length = self._manifest.segment_frames
        for record in records:
            if record.first_frame != record.segment * length or record.num_frames > length:
                raise CorruptError(f"{url}: segment {record.segment} does not fit the manifest")
        if not records and len(data) >= record_bytes(num_layers):
            raise CorruptError(f"{url} holds no record")
        return records

    def _get(self, url: str, limit_bytes: int) -> bytes:
        """The body at `url`, asked for again while the connection breaks."""
        retry = Retry(self._retry)
        while True:
            try:
                response = self._fetcher.get(url, limit_bytes)
                if response.status == 200:
                    return response.body
                if response.status < 500:
                    raise FetchError(f"{url}: HTTP {response.status}")
                raise BrokenError(f"{url}: HTTP {response.status}")
            except BrokenError as error:
                self._fetcher.pause(retry.delay_s(error))

    @property
    def name(self) -> str:
        return self._name

    @property
    def manifest(self) -> Manifest:
        return self._manifest

    @property
    def frames(self) -> FrameRange:
        return self._frames

    @property
    def received_bytes(self) -> int:
        return self._fetcher.received_bytes

    def _object(self, record: SegmentRecord, layer: int) -> bytes:
        url = urljoin(self._base, self._manifest.object_path(record.segment, layer))
        size = record.object_bytes[layer]
        if size > MAX_OBJECT_BYTES:
            raise CorruptError(f"{url}: the index says it has {size} bytes")
        data = self._get(url, size)
        if len(data) != size:
            raise CorruptError(f"{url} has {len(data)} bytes, the index says {size}")
        if hashlib.sha256(data).digest() != record.object_sha256[layer]:
            raise CorruptError(f"{url} was altered: its hash differs from the index")
        return data

    def slices(self) -> Iterator[ReceivedSlice]:
        manifest, end = self._manifest, self._frames.end
        assert end is not None  # static streams are opened as finished
        birth = self._frames.first - manifest.swin_size + 1
        while birth < end:
            record = self._records[manifest.segment_of(birth)]
            layers = range(self._layers)
            objects = [self._object(record, layer) for layer in layers]
            names = [
                urljoin(self._base, manifest.object_path(record.segment, layer)) for layer in layers
            ]
            for received in decode_segment(manifest, record, objects, names, birth):
                if received.slice.birth >= end:
                    return
                yield received
                birth = received.slice.birth + 1

    def interrupt(self) -> None:
        self._fetcher.interrupt()

    def close(self) -> None:
        self._fetcher.close()
