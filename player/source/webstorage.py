"""A stream's files under a URL, as a storage that codec reads from.

Rule: the connections belong to a thread that ends with the storage. A notebook has an event loop in
its own thread, and no second one can run there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar
from urllib.parse import urlsplit

from codec.errors import CorruptError, InvalidError, UnreadableError
from codec.storage.objectstore import without_credentials
from codec.storage.storage import Stamp
from codec.stream.manifest import MANIFEST_NAME, OBJECT_URL, SEGMENTS_NAME
from codec.stream.packedlayout import PackedLayout
from player.network.fetch import FetchConfig, Fetcher
from player.network.mirrors import Mirrors
from player.network.target import MissingError, joined, logins_of

from .hosted import HostedPlace
from .opener import ServedPlace, SourceConfig, locate, split_source

Result = TypeVar("Result")

_UNLISTED = "a web host cannot list its files"


class WebStorage:
    """The files under the URL that a source names: a static host's or a swings server's. Close it.

    One thread at a time may use it.
    """

    def __init__(self, source: str, config: SourceConfig | None = None) -> None:
        """Raises FetchError when no stream is there; of one on a swings server that shows when it
        is read."""
        self.name = without_credentials(source)
        self._config = config or SourceConfig()
        self._thread = ThreadPoolExecutor(1, "fetch")
        fetching = FetchConfig(other_hosts=self._config.other_hosts)
        self._fetcher = self._in_thread(
            lambda: Fetcher(config=fetching, logins=logins_of(split_source(source)))
        )
        self._object_url = OBJECT_URL
        self._layout: PackedLayout | None = None
        self._closed = False
        try:
            place = self._in_thread(lambda: locate(self.name, self._fetcher))
            retry = self._config.retry
            if isinstance(place, HostedPlace):
                self._base, self._object_url = place.bases[0], place.manifest.object_url
                self._layout = place.layout
                self._mirrors = place.mirrors(self._fetcher, retry)
            elif isinstance(place, ServedPlace):
                self._base = place.urls[0] + "/"
                self._mirrors = Mirrors((self._base,), self._fetcher, retry)
            else:
                raise InvalidError(f"{self.name} is not a URL")
        except BaseException:
            self.close()
            raise

    def _in_thread(self, work: Callable[[], Result]) -> Result:
        return self._thread.submit(work).result()

    @property
    def last_name(self) -> str:
        return urlsplit(self._base).path.rstrip("/").rpartition("/")[2]

    def place(self, path: str) -> str:
        if self._layout is not None:
            return f"{self._base}/{path}"
        folder, _, rest = path.partition("/")
        if folder == SEGMENTS_NAME and self._object_url != OBJECT_URL:
            segment, _, part = rest.partition("/")
            path = self._object_url.replace("{segment}", segment).replace("{layer}", part)
        return joined(self._base + MANIFEST_NAME, path, self._config.other_hosts)

    def check(self) -> None:
        """Whether anything is there shows when the manifest is read."""

    def read(
        self, path: str, limit_bytes: int, offset: int = 0, *, if_missing: str | None = None
    ) -> bytes:
        url = self.place(path)
        reference = url if self._layout is None else path
        try:
            found = self._in_thread(lambda: self._mirrors.get(reference, offset + limit_bytes))
        except MissingError as error:
            meaning = "" if if_missing is None else f"; {if_missing}"
            raise CorruptError(f"{url} is missing{meaning}") from error
        return bytes(found.data)[offset:]

    def stamp(self, path: str) -> Stamp | None:
        raise UnreadableError(f"{self.place(path)}: {_UNLISTED}")

    def holds(self, path: str) -> bool:
        raise UnreadableError(f"{self.place(path)}: {_UNLISTED}")

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
