"""A first look at a stream: its manifest and its poster, before anything of it is played."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from codec.errors import CodecError
from codec.stream import StreamReader
from codec.stream.manifest import MANIFEST_NAME, Manifest
from codec.stream.poster import MAX_PICTURE_BYTES, poster_path, read_poster
from player.network.faults import BrokenError, FetchError, StoppedError
from player.network.fetch import Fetcher

from .hosted import fetch_manifest
from .locate import Place, ServedPlace

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Glance:
    """What is seen of a stream at once."""

    manifest: Manifest
    poster: bytes | None
    """A picture's file, from whoever made the stream; None without one."""


def glance(place: Place, fetcher: Fetcher) -> Glance | None:
    """Looks at the stream at `place`; None where a server has none, who says more to who plays it.
    A poster that cannot be had is done without. Raises FetchError, CodecError."""
    if isinstance(place, Path):
        reader = StreamReader(place, max_gaussians=None)
        try:
            return Glance(reader.manifest, read_poster(reader.storage, reader.manifest))
        except CodecError as error:
            log.info("%s", error)
            return Glance(reader.manifest, None)
    if isinstance(place, ServedPlace):
        found = _served_manifest(place.urls, fetcher)
        if found is None:
            return None
        manifest, base = found
    else:
        manifest, base = place.manifest, place.bases[0]
    return Glance(manifest, _poster(manifest, base, fetcher))


def _served_manifest(urls: Sequence[str], fetcher: Fetcher) -> tuple[Manifest, str] | None:
    """From the first server that answers, and its folder."""
    for url in urls[:-1]:
        try:
            return fetch_manifest(fetcher, f"{url}/{MANIFEST_NAME}")
        except BrokenError as error:
            log.info("%s", error)
    return fetch_manifest(fetcher, f"{urls[-1]}/{MANIFEST_NAME}")


def _poster(manifest: Manifest, base: str, fetcher: Fetcher) -> bytes | None:
    name = poster_path(manifest)
    if name is None:
        return None
    try:
        response = fetcher.get(base + quote(name), MAX_PICTURE_BYTES)
    except StoppedError:
        raise
    except FetchError as error:
        log.info("%s", error)
        return None
    return response.body if response.status == 200 else None
