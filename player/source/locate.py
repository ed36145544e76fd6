"""From what the user typed to where it is: a folder, a served stream, or a hosted one."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import SplitResult, quote, unquote, urlsplit, urlunsplit

from codec.errors import InvalidError
from codec.stream.manifest import MANIFEST_NAME

from .fetch import Fetcher, FetchError
from .hosted import HostedPlace, fetch_manifest
from .hostedindex import HostedIndex

MAX_LIST_BYTES = 16 << 20
"""Longest list of streams read, bytes."""

SERVED = ("/v1/streams/", "/watch/")
"""What stands before a stream's name in the addresses of a swings server."""


@dataclass(frozen=True, slots=True)
class ServedPlace:
    """A stream that a swings server plays."""

    url: str
    """To which /play is added."""


Place = Path | ServedPlace | HostedPlace
"""Where a stream is."""


def is_url(source: str) -> bool:
    """Whether `source` is on the network; else it is a folder. Raises InvalidError for a URL of
    another kind."""
    if source.lower().startswith(("http://", "https://")):
        return True
    if "://" in source:
        raise InvalidError(f"{source}: only http:// and https:// URLs and folders can be played")
    return False


def check_url(source: str) -> SplitResult:
    """The parts of `source`. Raises InvalidError unless it is a URL with a host."""
    try:
        parts = urlsplit(source)
        host, _ = parts.hostname, parts.port
    except ValueError as error:  # urlsplit leaves the port unchecked until it is asked for
        raise InvalidError(f"{source} is not a URL: {error}") from error
    if not host:
        raise InvalidError(f"{source} is not a URL: it names no host")
    return parts


def locate(source: str, fetcher: Fetcher) -> Place:
    """Where the stream is that `source` names."""
    if not is_url(source):
        return Path(source)
    path = check_url(source).path.rstrip("/")
    served = _named_stream(source, path) if path else _only_stream(source, fetcher)
    if served is not None:
        return ServedPlace(served)
    base = _with_path(source, path.removesuffix(f"/{MANIFEST_NAME}")) + "/"
    found = fetch_manifest(fetcher, base + MANIFEST_NAME)
    if found is None:
        lacks = f"there is no {base}{MANIFEST_NAME}"
        if not path:
            lacks = f"it has neither a list of streams nor a {MANIFEST_NAME}"
        raise FetchError(f"{source} is not a stream: {lacks}")
    manifest, base = found
    return HostedPlace((base,), manifest, HostedIndex(manifest))


def _named_stream(source: str, path: str) -> str | None:
    """The URL of the served stream that `path` names; None where it is not such an address."""
    for prefix in SERVED:
        before, found, name = path.rpartition(prefix)
        if found and name and "/" not in name:
            return _stream_url(_with_path(source, before), unquote(name))
    return None


def _only_stream(source: str, fetcher: Fetcher) -> str | None:
    """The URL of the one stream that a server has; None where the host is not a swings server."""
    server = _with_path(source, "")
    response = fetcher.get(f"{server}/v1/streams", MAX_LIST_BYTES)
    names = _stream_names(response.body) if response.status == 200 else None
    if names is None:
        return None
    if not names:
        raise FetchError(f"{source} serves no stream yet")
    if len(names) > 1:
        shown = ", ".join(sorted(names)[:20]) + (", ..." if len(names) > 20 else "")
        raise FetchError(
            f"{source} serves {len(names)} streams: {shown}; "
            f"name one, as in {server}/watch/{names[0]}"
        )
    return _stream_url(server, names[0])


def _stream_url(server: str, name: str) -> str:
    return f"{server}/v1/streams/{quote(name, safe='')}"


def _with_path(source: str, path: str) -> str:
    parts = urlsplit(source)
    return urlunsplit((parts.scheme, parts.netloc, path, "", ""))


def _stream_names(body: bytes) -> list[str] | None:
    """The names in a server's list of streams; None when it is not one."""
    try:
        value = json.loads(body)
    except (ValueError, RecursionError):
        return None
    listed = value.get("streams") if isinstance(value, dict) else None
    if not isinstance(listed, list):
        return None
    names = [entry.get("name") for entry in listed if isinstance(entry, dict)]
    return [name for name in names if isinstance(name, str)]
