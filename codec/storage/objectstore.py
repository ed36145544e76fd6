"""Streams in an object store, such as S3 (extra `s3`), and its errors in one line that says what to
do.

Rule: names and passwords in URLs are for the host alone, never for messages, logs or reports.
Credentials, region and endpoint come from the environment, as obstore reads them.
"""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import timedelta
from typing import TYPE_CHECKING, Any, Literal, TypeVar, cast

from codec.errors import ConflictError, CorruptError, InvalidError, UnreadableError, UnwritableError

from .storage import Stamp

if TYPE_CHECKING:
    from obstore import GetOptions, ObjectMeta, PutMode
    from obstore.store import ObjectStore, RetryConfig

_USER_INFO = re.compile(r"(?<=://)[^/?#\s]*@")


def without_credentials(text: str) -> str:
    """`text` with names and passwords left out of every URL in it: `http://user:password@host/`
    becomes `http://host/`."""
    return _USER_INFO.sub("", text)


ENDPOINTS = {
    "AWS_ENDPOINT_URL_S3": "AWS_ALLOW_HTTP",
    "AWS_ENDPOINT_URL": "AWS_ALLOW_HTTP",
    "AWS_ENDPOINT": "AWS_ALLOW_HTTP",
    "AZURE_STORAGE_ENDPOINT": "AZURE_ALLOW_HTTP",
    "AZURE_ENDPOINT": "AZURE_ALLOW_HTTP",
}
"""Each variable from which obstore reads an endpoint, and the one that allows or forbids
http://."""


def settle_endpoints(environment: MutableMapping[str, str]) -> None:
    """Allows http:// where an endpoint begins with it, unless a variable already says otherwise.

    Written to `environment`, because options that are passed to obstore would replace all others
    that it reads there, such as AWS_TIMEOUT. Raises InvalidError for an endpoint that is no URL:
    obstore panics at its first request.
    """
    for name, allow in ENDPOINTS.items():
        endpoint = environment.get(name)
        if endpoint is None:
            continue
        scheme = endpoint.partition("://")[0].lower()
        if scheme not in ("http", "https"):
            raise InvalidError(
                f"{name} is {without_credentials(endpoint)!r}; set it to a URL that begins with "
                "https:// or http://, or unset it"
            )
        if scheme == "http":
            environment.setdefault(allow, "true")


CREDENTIALS = (
    "AWS_ACCESS_KEY_ID",
    "AWS_SECRET_ACCESS_KEY",
    "AWS_SKIP_SIGNATURE",
    "AWS_WEB_IDENTITY_TOKEN_FILE",
    "AWS_CONTAINER_CREDENTIALS_RELATIVE_URI",
    "AWS_CONTAINER_CREDENTIALS_FULL_URI",
)
"""The variables from which obstore gets credentials of S3, or learns that none are needed."""


def names_credentials(environment: Mapping[str, str]) -> bool:
    """Whether one of CREDENTIALS is set. If none is, only a machine of a cloud has credentials."""
    return any(name in environment for name in CREDENTIALS)


MAX_REASON_CHARS = 200

_METADATA = re.compile(r"http://169\.254\.169\.254/|/latest/(?:api/token|meta-data)")
"""Requests to the service from which machines of a cloud get credentials: obstore asks it if the
environment has none."""

_ANSWER = re.compile("<Code>(.*?)</Code>.*?<Message>(.*?)</Message>", re.DOTALL)
"""The error document of an S3 server."""

_DEBUG = "Debug source"
"""Marks the part of a text that is for the developers of obstore; it ends there."""

_ATTEMPTS = re.compile(r"in ([0-9.]+)(m?s), after ([0-9]+) retries")
"""The time that all attempts of a request took together, and the number of retries."""

_STATUS = re.compile(r"non-2xx status code: ([0-9]{3}[^:\n]*)")

_CAUSE = re.compile(r'(?:message|error): "([^"\n]+)"')
"""The operating system's reason for a failed connection, in the debug text."""

_PLAIN_ENDPOINT = re.compile(r"\bhttp://")


def describe(error: Exception) -> str:
    """The reason that the store or obstore gives for `error`, in one line."""
    text, _, debug = str(error).partition(_DEBUG)
    if advice := _advice(text):
        return advice
    reason = _reason(text, debug)
    line = text if reason is None else _attempts(text) + reason
    return without_credentials(" ".join(line.split()))[:MAX_REASON_CHARS]


def lacks_credentials(error: Exception) -> bool:
    """Whether no credentials were found, neither in the environment nor by the cloud's service."""
    return _METADATA.search(str(error).partition(_DEBUG)[0]) is not None


def _attempts(text: str) -> str:
    """How often and how long the request was tried; empty if only once."""
    found = _ATTEMPTS.search(text)
    if found is None:
        return ""
    return f"{int(found[3]) + 1} attempts in {float(found[1]):.0f} {found[2]} failed: "


def _reason(text: str, debug: str) -> str | None:
    """The store's own reason, or that of the operating system; None if neither is known."""
    if answer := _ANSWER.search(text + debug):
        return ": ".join(answer.groups())
    if status := _STATUS.search(text):
        return f"HTTP {status[1]}"
    if "kind: Timeout," in debug:
        return "no response in time"
    if "IncompleteMessage" in debug:
        return "connection closed without a response"
    causes = _CAUSE.findall(debug)
    return str(causes[-1]) if causes else None  # the last is the innermost


def _advice(text: str) -> str:
    """The setting to change where obstore's own words name a symptom; empty for another error."""
    if _METADATA.search(text):
        return (
            "no credentials: set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or "
            "AWS_SKIP_SIGNATURE=true for a public bucket"
        )
    if "builder error" in text and _PLAIN_ENDPOINT.search(text):
        return (
            "the endpoint is http://, without encryption, which AWS_ALLOW_HTTP forbids; set it to "
            "true, or use an https:// endpoint"
        )
    return ""


SCHEMES = ("s3", "s3a", "gs", "az", "azure", "abfs", "abfss")
"""Schemes of the URLs that name an object store."""


@dataclass(frozen=True)
class RetryPolicy:
    """How long a request is repeated when the store fails or cannot be reached."""

    duration_s: float
    """An attempt that fails later than this after the first one is the last, seconds."""

    shortest_pause_s: float
    """Least time between two attempts, seconds."""

    longest_pause_s: float
    """Most time between two attempts, seconds."""

    max_retries: int
    """Attempts after the first one, at most."""

    def for_obstore(self) -> RetryConfig:
        return {
            "max_retries": self.max_retries,
            "retry_timeout": timedelta(seconds=self.duration_s),
            "backoff": {
                # obstore draws each pause between the shortest and `base` times the last one. With
                # a base below e the pauses get shorter on average, not longer.
                "base": 3,
                "init_backoff": timedelta(seconds=self.shortest_pause_s),
                "max_backoff": timedelta(seconds=self.longest_pause_s),
            },
        }


BRIEF = RetryPolicy(10.0, 0.1, 1.0, max_retries=2)
"""Where a viewer or a user waits for the answer."""

# The time decides, not the number of attempts.
PATIENT = RetryPolicy(60.0, 0.5, 5.0, max_retries=10_000)
"""Where hours of work depend on the store."""

REQUESTS = 16
"""Requests at the same time when many files are looked at."""

Value = TypeVar("Value")

Version = dict[str, str]
"""An object's version as the store reports it; it changes with the content."""


class StorePrefix:
    """The files below a URL such as `s3://bucket/streams`."""

    def __init__(self, url: str, store: ObjectStore, retry: RetryPolicy, prefix: str = "") -> None:
        """Use `open_store`. prefix: in `store`, of every path; empty, or with '/' at its end."""
        self._url = without_credentials(url).rstrip("/")
        self._store = store
        self._retry = retry
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
        return StorePrefix(self.place(folder), self._store, self._retry, f"{self._prefix}{folder}/")

    def read(
        self, path: str, limit_bytes: int, offset: int = 0, *, if_missing: str | None = None
    ) -> bytes:
        found = self.read_version(path, limit_bytes, offset)
        if found is None:
            meaning = "" if if_missing is None else f"; {if_missing}"
            raise CorruptError(f"{self.place(path)} is missing{meaning}")
        return found[0]

    def read_version(
        self, path: str, limit_bytes: int, offset: int = 0
    ) -> tuple[bytes, Version] | None:
        """The object at `path` from `offset` on, and its version; None if there is none. Raises
        CorruptError."""
        return self._asked(path, lambda: self._get(path, limit_bytes, offset))

    def version(self, path: str) -> Version | None:
        """The version of the object at `path`; None if there is none. Raises UnreadableError."""
        import obstore

        found = self._asked(path, lambda: obstore.head(self._store, self._prefix + path))
        return None if found is None else _version(found)

    def _get(self, path: str, limit_bytes: int, offset: int) -> tuple[bytes, Version]:
        import obstore

        key = self._prefix + path
        # A store refuses a range that begins where the object ends.
        if offset and obstore.head(self._store, key)["size"] <= offset:
            return b"", {}
        options: GetOptions = {"range": {"offset": offset}} if offset else {}
        result = obstore.get(self._store, key, options=options)
        data = bytearray()
        if result.meta["size"] - offset <= limit_bytes:
            for piece in result.stream(1 << 20):
                data += piece
                if len(data) > limit_bytes:
                    break
            else:
                return bytes(data), _version(result.meta)
        raise CorruptError(f"{self.place(path)} is longer than {limit_bytes} bytes")

    def read_range(self, path: str, offset: int, size_bytes: int) -> bytes:
        """`size_bytes` bytes of the object at `path`, which has them. Raises CorruptError."""
        import obstore

        key, end = self._prefix + path, offset + size_bytes
        data = self._asked(
            path, lambda: bytes(obstore.get_range(self._store, key, start=offset, end=end))
        )
        if data is None or len(data) != size_bytes:
            raise CorruptError(
                f"{self.place(path)} has changed since it was opened; was it replaced?"
            )
        return data

    def put(self, path: str, data: bytes, over: Version | Literal["any"] | None = "any") -> Version:
        """Puts an object, whole; gives its version.

        over: what it may replace: any, only this version, or nothing (None). Raises ConflictError
        if something else is there, UnwritableError if the store does not take it.
        """
        import obstore
        import obstore.exceptions

        conflicts = (obstore.exceptions.AlreadyExistsError, obstore.exceptions.PreconditionError)
        mode: PutMode = "overwrite" if over == "any" else "create"
        if isinstance(over, dict):
            mode = cast("PutMode", over)
        last_attempt_s = time.monotonic() + self._retry.duration_s
        while True:
            try:
                # In one request: what is given up half way leaves nothing that has to be paid for.
                put = obstore.put(
                    self._store, self._prefix + path, data, mode=mode, use_multipart=False
                )
                return _version(put)
            except (*conflicts, FileNotFoundError) as error:
                if over == "any":
                    raise self._unwritable(path, error) from error
                raise ConflictError(f"{self.place(path)} was changed by another writer") from error
            except (obstore.exceptions.BaseError, ValueError, OSError) as error:
                # A refusal has a type of its own; any other fault leaves open whether the store has
                # done it. obstore does not repeat a conditional request then. Here it is repeated:
                # if the store had done it the next attempt is a ConflictError, and the caller
                # checks whether what lies there is its own.
                is_open = over != "any" and isinstance(error, obstore.exceptions.GenericError)
                if not is_open or time.monotonic() > last_attempt_s:
                    raise self._unwritable(path, error) from error
            time.sleep(self._retry.shortest_pause_s)

    def _unwritable(self, path: str, error: Exception) -> UnwritableError:
        return UnwritableError(f"{self.place(path)} cannot be written: {describe(error)}")

    def delete(self, path: str) -> None:
        """Deletes the object at `path`, and what lies below it. Raises UnwritableError."""
        import obstore
        import obstore.exceptions

        keys = [self._prefix + below for below, _ in self.sizes(path)]
        if self.stamp(path) is not None:
            keys.append(self._prefix + path)
        try:
            for begin in range(0, len(keys), 1000):
                obstore.delete(self._store, keys[begin : begin + 1000])
        except FileNotFoundError:
            return  # somebody was faster
        except (obstore.exceptions.BaseError, ValueError, OSError) as error:
            raise self._unwritable(path, error) from error

    def names(self) -> set[str]:
        """Names of the files and folders one level below. Raises UnreadableError."""
        files, folders = self._level()
        return {*files, *folders}

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

    def files(self, suffix: str) -> dict[str, Stamp]:
        names = [name for name in self._level()[0] if name.endswith(suffix) and name[0] != "."]
        stamps = {name: self.stamp(name) for name in names}
        return {name: stamp for name, stamp in stamps.items() if stamp is not None}

    def _folders(self) -> list[str]:
        return [name for name in self._level()[1] if not name.startswith(".")]

    def _level(self) -> tuple[list[str], list[str]]:
        """The names of the files and of the folders one level below."""
        import obstore

        prefix = self._prefix or None
        listed = self._asked("", lambda: obstore.list_with_delimiter(self._store, prefix))
        if listed is None:
            return [], []
        keys = [entry["path"] for entry in listed["objects"]], listed["common_prefixes"]
        files, folders = ([key.rpartition("/")[2] for key in found] for found in keys)
        return files, folders

    def sizes(self, folder: str) -> Iterator[tuple[str, int]]:
        import obstore

        def listed() -> list[tuple[str, int]]:
            pages = obstore.list(self._store, f"{self._prefix}{folder}", chunk_size=1000)
            begin = len(self._prefix)
            return [(entry["path"][begin:], entry["size"]) for page in pages for entry in page]

        yield from self._asked(folder, listed) or ()

    def _asked(self, path: str, ask: Callable[[], Value]) -> Value | None:
        """The result of `ask`; None if there is no such object. Raises UnreadableError."""
        import obstore.exceptions

        try:
            return ask()
        except FileNotFoundError:
            return None
        except (obstore.exceptions.BaseError, ValueError, OSError) as error:
            raise UnreadableError(
                f"{self.place(path)} cannot be read: {describe(error)}"
            ) from error


def _stamp(found: ObjectMeta) -> Stamp:
    tag = found["e_tag"] or found["last_modified"].isoformat()
    return Stamp(found["size"], (tag, found["version"] or ""))


def _version(found: Mapping[str, Any]) -> Version:
    return {name: found[name] for name in ("e_tag", "version") if found.get(name)}


def open_store(url: str, *, patient: bool = False) -> StorePrefix:
    """The storage below `url`, see `connect`."""
    return StorePrefix(url, *connect(url, patient=patient))


def connect(url: str, *, patient: bool) -> tuple[ObjectStore, RetryPolicy]:
    """The object store at `url`. patient: requests are repeated for a minute, see PATIENT.

    Raises InvalidError if it cannot be one, if obstore is not there or, if patient, if S3 needs
    credentials and there are none; whether the store answers shows when it is asked.
    """
    name = without_credentials(url)
    if url.partition("://")[0].lower() not in SCHEMES:
        names = ", ".join(f"{scheme}://" for scheme in SCHEMES)
        raise InvalidError(f"{name}: choose a folder on this machine, or a URL of {names}")
    try:
        import obstore.exceptions
        from obstore.store import from_url
    except ImportError as error:
        raise InvalidError(
            f"{name}: object stores need obstore; install it with "
            "pip install '.[s3]' in the folder of swings"
        ) from error
    settle_endpoints(os.environ)
    retry = PATIENT if patient else BRIEF
    try:
        store = from_url(url, retry_config=retry.for_obstore())
    except (obstore.exceptions.BaseError, ValueError) as error:
        raise InvalidError(f"{name} does not name an object store: {describe(error)}") from error
    if patient and url.lower().startswith("s3") and not names_credentials(os.environ):
        _check_credentials(url)
    return store, retry


def _check_credentials(url: str) -> None:
    """Raises InvalidError if the cloud's service gives none: not to repeat that for a minute."""
    import obstore
    import obstore.exceptions
    from obstore.store import from_url

    try:
        obstore.head(from_url(url, retry_config=BRIEF.for_obstore()), "manifest.json")
    except (obstore.exceptions.BaseError, ValueError, OSError) as error:
        if lacks_credentials(error):
            raise InvalidError(f"{without_credentials(url)}: {describe(error)}") from error
