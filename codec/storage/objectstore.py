"""Streams in an object store, such as S3 (extra `s3`).

Credentials, region and endpoint come from the environment, as obstore reads them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from typing import TYPE_CHECKING, TypeVar

from codec.errors import CorruptError, InvalidError, UnreadableError

from .storage import Stamp

if TYPE_CHECKING:
    from obstore import GetOptions, ObjectMeta
    from obstore.store import ObjectStore

SCHEMES = ("s3", "s3a", "gs", "az", "azure", "abfs", "abfss")
"""Of the URLs that name an object store."""

MAX_RETRIES = 2
RETRY_S = 10.0
"""How long a request is tried again when the store fails, seconds."""

REQUESTS = 16
"""Requests at the same time when many files are looked at."""

MAX_REASON_CHARS = 200

_ANSWER = re.compile("<Code>(.*?)</Code>.*?<Message>(.*?)</Message>", re.DOTALL)
"""In the error of an S3 server."""

Value = TypeVar("Value")


class StorePrefix:
    """What lies below a URL such as `s3://bucket/streams`."""

    def __init__(self, url: str, store: ObjectStore, prefix: str = "") -> None:
        """Use `open_store`. prefix: in `store`, of every path; empty, or with '/' at its end."""
        self._url = url.rstrip("/")
        self._store = store
        self._prefix = prefix

    @property
    def name(self) -> str:
        return self._url

    @property
    def last_name(self) -> str:
        return self._url.rpartition("/")[2]

    def place(self, path: str) -> str:
        return f"{self._url}/{path}"

    def check(self) -> None:
        self._folders()

    def below(self, folder: str) -> StorePrefix:
        return StorePrefix(self.place(folder), self._store, f"{self._prefix}{folder}/")

    def read(
        self, path: str, limit_bytes: int, offset: int = 0, *, if_missing: str | None = None
    ) -> bytes:
        data = self._asked(path, lambda: self._get(path, limit_bytes, offset))
        if data is None:
            meaning = "" if if_missing is None else f"; {if_missing}"
            raise CorruptError(f"{self.place(path)} is missing{meaning}")
        return data

    def _get(self, path: str, limit_bytes: int, offset: int) -> bytes:
        import obstore

        key = self._prefix + path
        # A store refuses a range that begins where the object ends.
        if offset and obstore.head(self._store, key)["size"] <= offset:
            return b""
        options: GetOptions = {"range": {"offset": offset}} if offset else {}
        result = obstore.get(self._store, key, options=options)
        data = bytearray()
        if result.meta["size"] - offset <= limit_bytes:
            for piece in result.stream(1 << 20):
                data += piece
                if len(data) > limit_bytes:
                    break
            else:
                return bytes(data)
        raise CorruptError(f"{self.place(path)} is longer than {limit_bytes} bytes")

    def stamp(self, path: str) -> Stamp | None:
        import obstore

        found = self._asked(path, lambda: obstore.head(self._store, self._prefix + path))
        return None if found is None else _stamp(found)

    def holds(self, path: str) -> bool:
        return self.stamp(path) is not None

    def folders(self, files: Sequence[str]) -> dict[str, tuple[Stamp | None, ...]]:
        names = self._folders()
        paths = [f"{name}/{file}" for name in names for file in files]
        with ThreadPoolExecutor(REQUESTS) as pool:
            stamps = list(pool.map(self.stamp, paths))
        width = len(files)
        rows = [tuple(stamps[n : n + width]) for n in range(0, len(stamps), width)]
        return {name: row for name, row in zip(names, rows, strict=True) if row[0] is not None}

    def _folders(self) -> list[str]:
        import obstore

        prefix = self._prefix or None
        listed = self._asked("", lambda: obstore.list_with_delimiter(self._store, prefix))
        found = [] if listed is None else listed["common_prefixes"]
        names = [path.rpartition("/")[2] for path in found]
        return [name for name in names if not name.startswith(".")]

    def sizes(self, folder: str) -> Iterator[tuple[str, int]]:
        import obstore

        def listed() -> list[tuple[str, int]]:
            pages = obstore.list(self._store, f"{self._prefix}{folder}", chunk_size=1000)
            begin = len(self._prefix)
            return [(entry["path"][begin:], entry["size"]) for page in pages for entry in page]

        yield from self._asked(folder, listed) or ()

    def _asked(self, path: str, ask: Callable[[], Value]) -> Value | None:
        """What `ask` gives; None if there is no such object. Raises UnreadableError."""
        import obstore.exceptions

        try:
            return ask()
        except FileNotFoundError:
            return None
        except (obstore.exceptions.BaseError, ValueError, OSError) as error:
            raise UnreadableError(f"{self.place(path)} cannot be read: {_said(error)}") from error


def _said(error: Exception) -> str:
    """What the store said, in a line."""
    answer = _ANSWER.search(str(error))
    # What follows in the text is for those who develop obstore.
    text = ": ".join(answer.groups()) if answer else str(error).partition("Debug source")[0]
    return " ".join(text.split())[:MAX_REASON_CHARS]


def _stamp(found: ObjectMeta) -> Stamp:
    tag = found["e_tag"] or found["last_modified"].isoformat()
    return Stamp(found["size"], (tag, found["version"] or ""))


def open_store(url: str) -> StorePrefix:
    """The object store at `url`. Raises InvalidError if it cannot be one, or if obstore is not
    there; whether the store answers shows when it is read."""
    try:
        import obstore.exceptions
        from obstore.store import from_url
    except ImportError as error:
        raise InvalidError(
            f"{url}: object stores need obstore; install it with pip install 'swings[s3]'"
        ) from error
    try:
        store = from_url(
            url,
            retry_config={
                "max_retries": MAX_RETRIES,
                "retry_timeout": timedelta(seconds=RETRY_S),
            },
        )
    except (obstore.exceptions.BaseError, ValueError) as error:
        raise InvalidError(f"{url} does not name an object store: {_said(error)}") from error
    return StorePrefix(url, store)
