"""A stream's files from whichever of its hosts has them.

Rule: what has come of a file is not asked for again; a host that fails is left for the next one.
"""

from __future__ import annotations

import random
import re
import time
from contextlib import closing
from dataclasses import dataclass, field

from codec.stream.manifest import MANIFEST_NAME

from .faults import BrokenError, FetchError
from .fetch import Fetcher, OpenResponse, Response
from .hosts import joined
from .retry import Retry, RetryConfig

PROGRESS_BYTES = 4096
"""A try that brought less has brought nothing: or who sends byte after byte is waited for."""


@dataclass(slots=True)
class Found:
    """A file, or what has come of it."""

    url: str = ""
    data: bytearray = field(default_factory=bytearray)
    tag: str = ""
    """What the host at `url` calls this content; empty if it does not say."""
    pieced: bool = False
    """Whether it came in several answers: they may be of different contents."""


class Mirrors:
    """The same files below several URLs, of which one is asked at a time."""

    def __init__(self, bases: tuple[str, ...], fetcher: Fetcher, retry: RetryConfig) -> None:
        """bases: each ends with a slash."""
        self._bases = bases
        self._fetcher = fetcher
        self._retry = retry
        self._at = 0

    def url(self, reference: str) -> str:
        """Where the file is that `reference` names, relative to the manifest. Raises FetchError."""
        base = self._bases[self._at] + MANIFEST_NAME
        return joined(base, reference, self._fetcher.config.other_hosts)

    def get(self, reference: str, limit_bytes: int) -> Found:
        """The file that `reference` names; see `url`. Raises FetchError."""
        retry, found = Retry(self._retry), Found()
        silent = missing = 0  # hosts in a row
        while True:
            before = len(found.data)
            try:
                self._read(self.url(reference), limit_bytes, found)
                return found
            except BrokenError as error:
                silent += 1
                if len(found.data) - before >= PROGRESS_BYTES:
                    retry.progress()
                if silent == len(self._bases):
                    self._wait(retry, error)
                    silent = missing = 0
            except FetchError:
                missing += 1
                silent += 1
                if missing == len(self._bases):
                    raise
                if silent == len(self._bases):
                    silent = missing = 0
            self._at = (self._at + 1) % len(self._bases)

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
                if range_start(response) != len(found.data):
                    found.data.clear()
                    raise BrokenError(f"{url}: it answers another range than was asked for")
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

    def tail(self, reference: str, first_byte: int, limit_bytes: int) -> bytes:
        """What the file has from `first_byte` on, which may be nothing. Raises FetchError."""
        retry = Retry(self._retry)
        while True:
            url = self.url(reference)
            try:
                with closing(
                    self._fetcher.open(url, {"Range": f"bytes={first_byte}-"})
                ) as response:
                    if response.status == 416:
                        return b""
                    if response.status == 206 and range_start(response) == first_byte:
                        return response.rest(limit_bytes)
                    if response.status == 200:
                        return response.rest(limit_bytes)[first_byte:]
                    raise refusal(url, response)
            except BrokenError as error:
                self._at = (self._at + 1) % len(self._bases)
                self._wait(retry, error)


def refusal(url: str, response: Response | OpenResponse) -> FetchError:
    """The error for an answer that is not the file."""
    message = f"{url}: HTTP {response.status}"
    if response.status >= 500 or response.status in (408, 416, 429):
        return BrokenError(message, response.retry_after_s)
    return FetchError(message)


def range_start(response: OpenResponse) -> int | None:
    """The byte that an answer of 206 begins with; None if it does not say."""
    found = re.match(r"bytes (\d{1,18})-", response.headers.get("Content-Range", ""))
    return int(found[1]) if found else None


def strong_tag(response: OpenResponse) -> str:
    """What If-Range takes; empty if the answer has none."""
    tag = response.headers.get("ETag", "")
    if tag and not tag.startswith("W/"):
        return tag
    return response.headers.get("Last-Modified", "")
