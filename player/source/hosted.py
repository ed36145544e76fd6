"""A stream on any static host: manifest, index and objects fetched one by one."""

from __future__ import annotations

from collections.abc import Iterator
from urllib.parse import urljoin

from codec.errors import CodecError
from codec.framerange import FrameRange
from codec.slice import window_births
from codec.stream.index import INDEX_NAME, SegmentRecord
from codec.stream.integrity import MAX_INDEX_BYTES, CheckedObject, read_index
from codec.stream.manifest import MAX_MANIFEST_BYTES, Manifest

from .fetch import BrokenError, Fetcher, FetchError
from .retry import Retry, RetryConfig
from .source import ReceivedSlice, check_frames, check_layers, segment_slices


def fetch_manifest(fetcher: Fetcher, url: str) -> Manifest | None:
    """The manifest at `url`; None if there is nothing. Raises FetchError for anything else."""
    response = fetcher.get(url, MAX_MANIFEST_BYTES)
    if response.status in (404, 410):
        return None
    if response.status != 200:
        raise FetchError(f"{url} is not a stream: HTTP {response.status}")
    try:
        return Manifest.from_json(response.body)
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
        self._layers = check_layers(layers, manifest, name)
        self._records = self._read_index()
        last = self._records[-1] if self._records else None
        num_frames = last.first_frame + last.num_frames if last else 0
        finished = manifest.with_live(False)
        self.frames = check_frames(frames, finished, num_frames, name)

    @property
    def received_bytes(self) -> int:
        return self._fetcher.received_bytes

    def _read_index(self) -> list[SegmentRecord]:
        url = urljoin(self._base, INDEX_NAME)
        try:
            return read_index(self._get(url, MAX_INDEX_BYTES), self.manifest)
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
                if response.status < 500:
                    raise FetchError(f"{url}: HTTP {response.status}")
                raise BrokenError(f"{url}: HTTP {response.status}")
            except BrokenError as error:
                self._fetcher.pause(retry.delay_s(error))

    def _object(self, record: SegmentRecord, layer: int) -> CheckedObject:
        url = urljoin(self._base, self.manifest.object_path(record.segment, layer))
        data = self._get(url, record.object_bytes[layer])
        return CheckedObject.check(url, data, self.manifest, record, layer)

    def slices(self) -> Iterator[ReceivedSlice]:
        manifest, end = self.manifest, self.frames.end
        assert end is not None  # a hosted stream is opened as finished
        birth = window_births(self.frames.first, manifest.swin_size).start
        while birth < end:
            record = self._records[manifest.segment_of(birth)]
            objects = [self._object(record, layer) for layer in range(self._layers)]
            for received in segment_slices(objects, birth, end):
                yield received
                birth = received.slice.birth + 1

    def interrupt(self) -> None:
        self._fetcher.interrupt()

    def close(self) -> None:
        self._fetcher.close()
