"""A stream's files from whichever of its hosts has them, one by one or in one large file.

Rule: received bytes of a file are not requested again; after a failure the next host is tried.
"""

from __future__ import annotations

import random
import re
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field

from codec.stream.manifest import MANIFEST_NAME

from .fetch import Fetcher, Response, Retry, RetryConfig
from .target import BrokenError, FetchError, MissingError, joined

PROGRESS_BYTES = 4096
"""Fewer bytes than this count as no progress, so a host that trickles bytes is not waited for."""


@dataclass(frozen=True, slots=True)
class Extent:
    """A run of bytes of a larger file, which stands for a file of its own."""

    first_byte: int
    num_bytes: int
    file_bytes: int
    """Size of the larger file."""

    def header(self, first_byte: int, end_byte: int) -> str:
        """The Range for a part of it, whose bytes count from its own first one."""
        return f"bytes={self.first_byte + first_byte}-{self.first_byte + end_byte - 1}"


Find = Callable[[str], Extent]
"""Where a file lies in a larger one, by its reference. Raises MissingError."""


@dataclass(slots=True)
class Found:
    """A file, or the part of it that was received."""

    url: str = ""
    data: bytearray = field(default_factory=bytearray)
    tag: str = ""
    """The host's tag of the content at `url`; empty if it does not say."""
    pieced: bool = False
    """Whether it came in several answers: they may be of different contents."""


class Mirrors:
    """The same files below several URLs, of which one is asked at a time."""

    def __init__(
        self,
        bases: tuple[str, ...],
        fetcher: Fetcher,
        retry: RetryConfig,
        find: Find | None = None,
    ) -> None:
        """bases: each ends with a slash; with `find`, each is the URL of a file that holds all the
        others."""
        self._bases = bases
        self._find = find
        self._fetcher = fetcher
        self._retry = retry
        self._at = 0

    def url(self, reference: str) -> str:
        """Where the file is that `reference` names, relative to the manifest. Raises FetchError."""
        if self._find is not None:
            return self._bases[self._at]
        base = self._bases[self._at] + MANIFEST_NAME
        return joined(base, reference, self._fetcher.config.other_hosts)

    def name(self, reference: str) -> str:
        """The name of the file `reference` in errors. Raises FetchError."""
        url = self.url(reference)
        return url if self._find is None else f"{url}/{reference}"

    def extent(self, reference: str) -> Extent | None:
        """Where it lies in the file at `url`; None if it is that file. Raises MissingError."""
        return None if self._find is None else self._find(reference)

    def get(self, reference: str, limit_bytes: int) -> Found:
        """The file that `reference` names; see `url`. Raises FetchError."""
        tries, found, extent = _Tries(self, self._retry), Found(), self.extent(reference)
        while True:
            before, at = len(found.data), self._at
            try:
                if extent is None:
                    self._read(self.url(reference), limit_bytes, found)
                else:
                    self._read_extent(self.url(reference), extent, limit_bytes, found)
                return found
            except FetchError as error:
                tries.failed(error, at, len(found.data) - before)

    def span(self, reference: str, first_byte: int, end_byte: int, file_bytes: int) -> Span:
        """Bytes first_byte..end_byte-1 of a file of `file_bytes`, which are asked for at
        once. Close it."""
        return Span(self, _Tries(self, self._retry), reference, (first_byte, end_byte), file_bytes)

    def _wait(self, retry: Retry, error: BrokenError) -> None:
        self._fetcher.pause(retry.delay_s(error, time.monotonic(), random.random()))

    def _read(self, url: str, limit_bytes: int, found: Found) -> None:
        """Adds to `found` what is missing."""
        asked = {}
        if found.data:
            asked["Range"] = f"bytes={len(found.data)}-"
            if found.tag and found.url == url:
                asked["If-Range"] = found.tag
        with closing(self._fetcher.open(url, asked)) as response:
            if response.status == 206 and found.data:
                if content_range(response)[0] != len(found.data):
                    found.data.clear()
                    raise BrokenError(f"{url}: the host sent another range than requested")
                found.pieced = True
            elif response.status == 200:
                found.data.clear()
                found.pieced = False
            else:
                found.data.clear()
                raise refusal(url, response)
            found.url, found.tag = url, strong_tag(response)
            for piece in response.pieces():
                found.data += piece
                if len(found.data) > limit_bytes:
                    raise FetchError(f"{url} is longer than {limit_bytes} bytes")

    def _read_extent(self, url: str, extent: Extent, limit_bytes: int, found: Found) -> None:
        """Adds to `found` what is missing of an extent."""
        if extent.num_bytes > limit_bytes:
            raise FetchError(f"{url}: a file in it is longer than {limit_bytes} bytes")
        begin = len(found.data)
        asked = {"Range": extent.header(begin, extent.num_bytes)}
        with closing(self._fetcher.open(url, asked)) as response:
            check_range(response, extent.first_byte + begin, extent.file_bytes)
            found.url, found.pieced = url, begin > 0
            for piece in response.pieces():
                found.data += piece
                if len(found.data) > extent.num_bytes:
                    raise FetchError(f"{url}: the host sent more bytes than requested")
        if len(found.data) < extent.num_bytes:
            raise BrokenError(f"{url}: the response ended early")

    def tail(self, reference: str, first_byte: int, limit_bytes: int) -> bytes:
        """The file from `first_byte` on, which may be empty. Raises FetchError."""
        if self._find is not None:
            return bytes(self.get(reference, limit_bytes).data)[first_byte:]
        retry = Retry(self._retry)
        while True:
            url = self.url(reference)
            try:
                with closing(
                    self._fetcher.open(url, {"Range": f"bytes={first_byte}-"})
                ) as response:
                    if response.status == 416:
                        return b""
                    if response.status == 206 and content_range(response)[0] == first_byte:
                        return response.rest(limit_bytes)
                    if response.status == 200:
                        return response.rest(limit_bytes)[first_byte:]
                    raise refusal(url, response)
            except BrokenError as error:
                self._at = (self._at + 1) % len(self._bases)
                self._wait(retry, error)


class _Tries:
    """Failures while one file is fetched, and the choice of the next host."""

    def __init__(self, mirrors: Mirrors, retry: RetryConfig) -> None:
        self._mirrors = mirrors
        self._retry = Retry(retry)
        self._silent = self._missing = 0  # hosts in a row

    def failed(self, error: FetchError, at: int, num_bytes: int) -> None:
        """Host number `at` has failed after `num_bytes` new bytes. Turns to the next one, after a
        while if all have failed. Raises FetchError when there is no hope."""
        mirrors, num_hosts = self._mirrors, len(self._mirrors._bases)
        self._silent += 1
        if isinstance(error, BrokenError):
            if num_bytes >= PROGRESS_BYTES:
                self._retry.progress()
            if self._silent == num_hosts:
                mirrors._wait(self._retry, error)
        else:
            self._missing += 1
            if self._missing == num_hosts:
                raise error
        if self._silent == num_hosts:
            self._silent = self._missing = 0
        if mirrors._at == at:  # else another request has turned away from it
            mirrors._at = (at + 1) % num_hosts


class Span:
    """A run of bytes of a file, asked for when it is made. What breaks off is asked for again from
    the byte that is missing."""

    def __init__(
        self,
        mirrors: Mirrors,
        tries: _Tries,
        reference: str,
        span: tuple[int, int],
        file_bytes: int,
    ) -> None:
        self._mirrors, self._tries, self._reference = mirrors, tries, reference
        self._at_byte, self._end_byte = span
        self._reached_byte = self._at_byte  # by the tries before
        self._file_bytes = file_bytes
        self._extent = mirrors.extent(reference)
        self.is_whole = span == (0, file_bytes)
        """Whether the whole file comes: it was asked for, or the host knows no ranges."""
        self._ask()

    def _ask(self) -> None:
        mirrors, fields = self._mirrors, {}
        self._host = mirrors._at
        self.url = mirrors.url(self._reference)
        """Where it is asked for now."""
        self.name = mirrors.name(self._reference)
        """Its name in errors."""
        if self._extent is not None:
            fields["Range"] = self._extent.header(self._at_byte, self._end_byte)
        elif (self._at_byte, self._end_byte) != (0, self._file_bytes):
            fields["Range"] = f"bytes={self._at_byte}-{self._end_byte - 1}"
        self._asked = mirrors._fetcher.ask(self.url, fields, self._file_bytes)
        self._is_checked = False
        self._reached_byte = max(self._reached_byte, self._at_byte)

    @property
    def ended(self) -> bool:
        """Whether all of it was collected."""
        return self._at_byte == self._end_byte

    def collect(self) -> list[tuple[int, bytes]]:
        """(First byte, bytes) of pieces that have arrived, see `Fetcher.wait`. Waits only where all
        hosts fail. Raises FetchError."""
        try:
            return self._collect()
        except FetchError as error:
            self.close()
            self._tries.failed(error, self._host, self._at_byte - self._reached_byte)
            self._ask()
            return []

    def _collect(self) -> list[tuple[int, bytes]]:
        asked = self._asked
        if asked.response is not None and not self._is_checked:
            self._check(asked.response)
            self._is_checked = True
        found = []
        while asked.pieces:
            piece = asked.pieces.popleft()
            found.append((self._at_byte, piece))
            self._at_byte += len(piece)
        if self._at_byte > self._end_byte:
            raise FetchError(f"{self.url}: the host sent more bytes than requested")
        if not found and asked.ended:
            raise asked.error or BrokenError(f"{self.url}: the response ended early")
        return found

    def _check(self, response: Response) -> None:
        """Looks whether it is an answer to what was asked for."""
        if self._extent is not None:
            check_range(response, self._extent.first_byte + self._at_byte, self._extent.file_bytes)
            return
        if response.status == 206:
            first_byte, total = content_range(response)
            if first_byte != self._at_byte:
                raise BrokenError(f"{self.url}: the host sent another range than requested")
        elif response.status == 200:
            length = response.headers.get("Content-Length", "")
            known = length.isascii() and length.isdecimal() and len(length) <= 18
            total = int(length) if known else None
            self._at_byte, self._end_byte, self.is_whole = 0, self._file_bytes, True
        else:
            raise refusal(self.url, response)
        if total not in (None, self._file_bytes):
            raise FetchError(f"{self.url} has {total} bytes, but the index says {self._file_bytes}")

    def close(self) -> None:
        """Drops what did not come, and the connection with it."""
        self._asked.close()


def check_range(response: Response, first_byte: int, file_bytes: int | None = None) -> int:
    """Raises FetchError unless `response` has bytes from `first_byte` on of a file of `file_bytes`;
    None allows any. Gives how many the file has."""
    url = response.url
    if response.status == 200:
        raise FetchError(
            f"{url}: the host does not send parts of a file, as a .swings file needs; use a host "
            "that answers Range requests, or swings-stream unpack"
        )
    if response.status != 206:
        raise refusal(url, response)
    begin, total = content_range(response)
    if begin != first_byte or total is None:
        raise BrokenError(f"{url}: the host sent another range than requested")
    if file_bytes is not None and total != file_bytes:
        raise FetchError(f"{url}: the stream was replaced by another one; play it again")
    return total


def refusal(url: str, response: Response) -> FetchError:
    """The error for an answer that is not the file."""
    message = f"{url}: HTTP {response.status}"
    if response.status >= 500 or response.status in (408, 416, 429):
        return BrokenError(message, response.retry_after_s)
    if response.status in (404, 410):
        return MissingError(message)
    return FetchError(message)


def content_range(response: Response) -> tuple[int | None, int | None]:
    """The byte that an answer of 206 begins with, and the size of its file; None for what it does
    not say."""
    text = response.headers.get("Content-Range", "")
    first = re.match(r"bytes (\d{1,18})-", text)
    total = re.fullmatch(r"bytes [\d-]{1,40}/(\d{1,18})", text)
    return int(first[1]) if first else None, int(total[1]) if total else None


def strong_tag(response: Response) -> str:
    """The value for If-Range; empty if the answer has none."""
    tag = response.headers.get("ETag", "")
    if tag and not tag.startswith("W/"):
        return tag
    return response.headers.get("Last-Modified", "")
