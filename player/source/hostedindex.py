"""The index of a stream on a static host, which may still grow."""

from __future__ import annotations

from codec.errors import CodecError, CorruptError
from codec.stream.index import INDEX_NAME, SegmentRecord, record_bytes
from codec.stream.integrity import read_index
from codec.stream.manifest import Manifest
from player.network.mirrors import Mirrors

from .sizelimits import SizeLimits

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
