"""A stream's files under a URL, as a storage that codec reads from.

Rule: the connections belong to a thread that ends with the storage. A notebook has an event loop in
its own thread, and no second one can run there.
"""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar
from urllib.parse import urlsplit

from codec.errors import CorruptError, UnreadableError
from codec.storage.storage import Stamp
from codec.stream.manifest import MANIFEST_NAME, OBJECT_URL, SEGMENTS_NAME

from .fetch import BrokenError, Fetcher, FetchError
from .hosted import fetch_manifest
from .hosts import joined
from .locate import stream_url
from .retry import Retry, RetryConfig

Result = TypeVar("Result")

_UNLISTED = "a web host does not tell what it has"


class WebStorage:
    """The files under the URL that a source names: a static host's or a swings server's. Close it.

    One thread at a time may use it.
    """

    def __init__(self, source: str, retry: RetryConfig | None = None) -> None:
        """Raises FetchError when no stream is there."""
        self.name = source
        self._retry = retry or RetryConfig()
        self._thread = ThreadPoolExecutor(1, "fetch")
        self._fetcher = self._in_thread(Fetcher)
        self._object_url = OBJECT_URL
        self._closed = False
        try:
            self._base = self._in_thread(lambda: stream_url(source, self._fetcher))
            manifest_url = self.place(MANIFEST_NAME)
            manifest = self._in_thread(lambda: fetch_manifest(self._fetcher, manifest_url))
            if manifest is None:
                raise FetchError(f"{source} is not a stream: there is no {manifest_url}")
            self._object_url = manifest.object_url
        except BaseException:
            self.close()
            raise

    def _in_thread(self, work: Callable[[], Result]) -> Result:
        return self._thread.submit(work).result()

    @property
    def last_name(self) -> str:
        return urlsplit(self._base).path.rstrip("/").rpartition("/")[2]

    def place(self, path: str) -> str:
        folder, _, rest = path.partition("/")
        if folder == SEGMENTS_NAME and self._object_url != OBJECT_URL:
            segment, _, part = rest.partition("/")
            path = self._object_url.replace("{segment}", segment).replace("{layer}", part)
        return joined(self._base, path, other_hosts=False)

    def check(self) -> None:
        """The manifest was there when this was made."""

    def below(self, folder: str) -> WebStorage:
        return WebStorage(self.place(folder), self._retry)

    def read(
        self, path: str, limit_bytes: int, offset: int = 0, *, if_missing: str | None = None
    ) -> bytes:
        url = self.place(path)
        body = self._in_thread(lambda: self._get(url, offset + limit_bytes))
        if body is None:
            meaning = "" if if_missing is None else f"; {if_missing}"
            raise CorruptError(f"{url} is missing{meaning}")
        return body[offset:]

    def _get(self, url: str, limit_bytes: int) -> bytes | None:
        """The body at `url`, asked for again while the connection breaks; None if there is
        nothing."""
        retry = Retry(self._retry)
        while True:
            try:
                response = self._fetcher.get(url, limit_bytes)
                if response.status == 200:
                    return response.body
                if response.status in (404, 410):
                    return None
                if response.status < 500 and response.status != 429:
                    raise FetchError(f"{url}: HTTP {response.status}")
                raise BrokenError(f"{url}: HTTP {response.status}", response.retry_after_s)
            except BrokenError as error:
                delay_s = retry.delay_s(error, time.monotonic(), random.random())
                self._fetcher.pause(delay_s)

    # What nobody asks of a single stream.

    def stamp(self, path: str) -> Stamp | None:
        raise UnreadableError(f"{self.place(path)}: {_UNLISTED}")

    def holds(self, path: str) -> bool:
        raise UnreadableError(f"{self.place(path)}: {_UNLISTED}")

    def folders(self, files: Sequence[str]) -> dict[str, tuple[Stamp | None, ...]]:
        raise UnreadableError(f"{self.name}: {_UNLISTED}")

    def sizes(self, folder: str) -> Iterator[tuple[str, int]]:
        raise UnreadableError(f"{self.place(folder)}: {_UNLISTED}")

    def close(self) -> None:
        """Closes all connections and ends the thread; closing twice is the same as once."""
        if self._closed:
            return
        self._closed = True
        self._fetcher.interrupt()
        self._thread.submit(self._fetcher.close)
        self._thread.shutdown()
