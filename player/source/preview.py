"""A preview of a stream: its manifest and its poster, before anything of it is played."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from codec.errors import CodecError
from codec.stream import StreamReader
from codec.stream.manifest import MANIFEST_NAME, Manifest
from codec.stream.packedlayout import PackedLayout
from codec.stream.pictures import MAX_PICTURE_BYTES, picture_path, read_picture
from player.network.faults import BrokenError, FetchError
from player.network.fetch import Fetcher

from .hosted import fetch_manifest, fetch_range
from .locate import Place, ServedPlace

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Preview:
    """Manifest and poster of a stream."""

    manifest: Manifest
    poster: bytes | None
    """A picture's file, as the maker of the stream left it; None without one."""


def load_preview(place: Place, fetcher: Fetcher) -> Preview | None:
    """The preview of the stream at `place`; None where a server has no such stream, which its
    answer to a play explains. A poster that cannot be fetched is left out. Raises FetchError,
    CodecError."""
    if isinstance(place, Path):
        reader = StreamReader(place, max_gaussians=None)
        try:
            return Preview(reader.manifest, read_picture(reader.storage, reader.manifest.poster))
        except CodecError as error:
            log.info("%s", error)
            return Preview(reader.manifest, None)
    layout: PackedLayout | None = None
    if isinstance(place, ServedPlace):
        found = _served_manifest(place.urls, fetcher)
        if found is None:
            return None
        manifest, base = found
    else:
        manifest, base, layout = place.manifest, place.bases[0], place.layout
    try:
        return Preview(manifest, _poster(manifest, base, layout, fetcher))
    except FetchError as error:
        log.info("%s", error)
        return Preview(manifest, None)


def _served_manifest(urls: Sequence[str], fetcher: Fetcher) -> tuple[Manifest, str] | None:
    """From the first server that answers, and its folder."""
    for url in urls[:-1]:
        try:
            return fetch_manifest(fetcher, f"{url}/{MANIFEST_NAME}")
        except BrokenError as error:
            log.info("%s", error)
    return fetch_manifest(fetcher, f"{urls[-1]}/{MANIFEST_NAME}")


def _poster(
    manifest: Manifest, base: str, layout: PackedLayout | None, fetcher: Fetcher
) -> bytes | None:
    name = picture_path(manifest.poster)
    if name is None:
        return None
    if layout is not None:
        found = layout.find(name)
        return None if found is None else fetch_range(fetcher, base, *found)[0]
    response = fetcher.get(base + quote(name), MAX_PICTURE_BYTES)
    return response.body if response.status == 200 else None
