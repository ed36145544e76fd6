"""The place of the stream that the user named: on this machine, served, or hosted."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, replace
from pathlib import Path
from urllib.parse import SplitResult, quote, unquote, urlsplit, urlunsplit

from codec.errors import InvalidError
from codec.storage.credentials import without_credentials
from codec.stream.manifest import MANIFEST_NAME
from codec.stream.packedlayout import PACKED_SUFFIX
from player.network.faults import BrokenError, FetchError
from player.network.fetch import Fetcher

from .hosted import HostedPlace, fetch_manifest, fetch_packed
from .hostedindex import HostedIndex

MAX_LIST_BYTES = 16 << 20
"""Longest list of streams read, bytes."""

SERVED = ("/v1/streams/", "/watch/")
"""Prefixes of a stream's name in the addresses of a swings server."""


@dataclass(frozen=True, slots=True)
class ServedPlace:
    """A stream that swings servers play."""

    urls: tuple[str, ...]
    """URL of the stream on each server; /play is added to one of them."""


Place = Path | ServedPlace | HostedPlace
"""Where a stream is."""


def is_url(source: str) -> bool:
    """Whether `source` is on the network; else it is a folder. Raises InvalidError for a URL of
    another kind."""
    if source.lower().startswith(("http://", "https://")):
        return True
    if "://" in source:
        shown = without_credentials(source)
        raise InvalidError(f"{shown}: only http:// and https:// URLs and folders can be played")
    return False


def check_url(source: str) -> SplitResult:
    """The parts of `source`. Raises InvalidError unless it is a URL with a host."""
    try:
        parts = urlsplit(source)
        host, _ = parts.hostname, parts.port
    except ValueError as error:  # urlsplit leaves the port unchecked until it is asked for
        raise InvalidError(f"{without_credentials(source)} is not a URL: {error}") from error
    if not host:
        raise InvalidError(f"{without_credentials(source)} is not a URL: it has no host")
    return parts


def split_source(source: str) -> list[str]:
    """The URLs, between commas, that `source` gives for one stream."""
    return re.split(r",(?=https?://)", source, flags=re.IGNORECASE)


def locate(source: str, fetcher: Fetcher) -> Place:
    """Where the stream is that `source` names. Of several URLs the first that answers says what
    kind of host they all are."""
    names = split_source(source)
    for number, name in enumerate(names):
        try:
            found = _locate(name, fetcher)
        except BrokenError:
            if name is names[-1]:
                raise
            continue
        others = names[:number] + names[number + 1 :]
        match found:
            case ServedPlace(urls=urls):
                stream = urls[0].rpartition("/")[2]
                urls += tuple(_named_url(other, stream) for other in others)
                return ServedPlace(urls)
            case HostedPlace(layout=None):
                return replace(found, bases=found.bases + tuple(map(_base, others)))
            case HostedPlace():
                return replace(found, bases=found.bases + tuple(others))
        return found
    raise AssertionError("a text has one part at least")


def _named_url(source: str, stream: str) -> str:
    """The URL of a served stream on another server than the one where it is called `stream`."""
    path = check_url(source).path.rstrip("/")
    return _named_stream(source, path) or f"{_with_path(source, path)}{SERVED[0]}{stream}"


def _base(source: str) -> str:
    """The URL of the folder of a stream on a static host, with a slash."""
    path = check_url(source).path.rstrip("/")
    return _with_path(source, path.removesuffix(f"/{MANIFEST_NAME}")) + "/"


def _locate(source: str, fetcher: Fetcher) -> Place:
    if not is_url(source):
        return Path(source)
    path = check_url(source).path.rstrip("/")
    served = _named_stream(source, path) if path else _only_stream(source, fetcher)
    if served is not None:
        return ServedPlace((served,))
    if path.endswith(PACKED_SUFFIX):
        return fetch_packed(fetcher, source)
    base = _base(source)
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
            f"choose one, such as {server}/watch/{names[0]}"
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
