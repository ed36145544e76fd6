"""The place of the stream that the user named, on this machine, served or hosted; a preview of it;
and the stream, opened again and again at other frames, in other layers.

Rule: what was learnt once is not asked for again: where the stream is, its manifest, the
connections to its host, and what the server knows of the link.
"""

from __future__ import annotations

import json
import logging
import random
import re
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from urllib.parse import SplitResult, quote, unquote, urlsplit, urlunsplit

from codec.errors import CodecError, CorruptError, InvalidError
from codec.framerange import FrameRange
from codec.storage.objectstore import without_credentials
from codec.stream import StreamReader
from codec.stream.captions import MAX_CAPTIONS_BYTES
from codec.stream.manifest import MANIFEST_NAME, Manifest, object_name
from codec.stream.packedlayout import PACKED_SUFFIX, PackedLayout
from codec.stream.packedstorage import open_place
from codec.stream.pictures import MAX_PICTURE_BYTES, picture_path, read_picture
from codec.stream.reader import DEFAULT_MAX_GAUSSIANS, check_gaussians, read_stream_file
from player.network.fetch import FetchConfig, Fetcher, Retry, RetryConfig
from player.network.mirrors import Mirrors
from player.network.target import BrokenError, FetchError, StoppedError, logins_of

from .directory import DirectorySource
from .hosted import (
    HostedIndex,
    HostedPlace,
    HostedSource,
    fetch_manifest,
    fetch_packed,
    fetch_range,
)
from .served import ServedSource
from .soundfiles import FolderSound, HostedSound, SoundFiles
from .source import NO_PLAY, Source

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


@dataclass(frozen=True, slots=True)
class SourceConfig:
    """How streams are got from the network."""

    retry: RetryConfig = field(default_factory=RetryConfig)
    """Patience with servers that fail."""
    other_hosts: bool = False
    """Whether a stream may lead to other hosts than its own."""


class Opener:
    """Opens the stream that `source` names, one Source after another.

    `interrupt` may come from any thread, everything else from one thread at a time.
    """

    def __init__(
        self,
        source: str,
        via: tuple[str, int] | None = None,
        received: Callable[[int], None] | None = None,
        config: SourceConfig | None = None,
        max_gaussians: int | None = DEFAULT_MAX_GAUSSIANS,
    ) -> None:
        """Asks for nothing yet. via: the relay of `--link`. received: is told how many bytes each
        read from the network gave. max_gaussians: a larger stream is refused when it is opened,
        see `check_gaussians`."""
        self._config = config or SourceConfig()
        self._max_gaussians = max_gaussians
        self.name = without_credentials(source)
        self.manifest: Manifest | None = None
        """As it was when the stream was opened last; None before that."""
        fetch = FetchConfig(other_hosts=self._config.other_hosts)
        self._fetcher = Fetcher(via, fetch, received, logins=logins_of(split_source(source)))
        self._place: Place | None = None
        self._last: Source | None = None
        self._lock = threading.Lock()
        self._using: Fetcher | None = None
        self._stopped = False

    def open(self, frames: FrameRange, layers: int | None, adaptive: bool = False) -> Source:
        """The stream from `frames.first` on. Of the one before it all packets must have come, or it
        must be closed.

        layers: None takes all. adaptive: where layers is None, those that the link allows; from a
        folder all the same. Raises CorruptError when the stream is not the one that was opened
        before, UnsupportedError when it has too many Gaussians.
        """
        fetcher = self._use()
        try:
            source = self._open_patiently(fetcher, frames, layers, adaptive)
        except BaseException:
            fetcher.close()
            raise
        try:
            self._check(source.manifest)
        except BaseException:
            source.close()
            raise
        self._last = source
        return source

    def preview(self) -> Preview | None:
        """Manifest and poster, to be shown while the player starts; see `load_preview`."""
        with closing(self._use()) as fetcher:
            found = load_preview(self._find(fetcher), fetcher)
        if found is not None:
            check_gaussians(found.manifest, self._max_gaussians, self.name)
        return found

    def sound_files(self) -> SoundFiles:
        """The objects of sound of the stream, which was opened before, over connections of their
        own. Close it before this."""
        place = self._place
        assert place is not None
        if isinstance(place, Path):
            return FolderSound(place)
        fetcher, retry = self._fetcher.another(self._fetcher.config), self._config.retry
        if isinstance(place, ServedPlace):
            bases = tuple(f"{url}/" for url in place.urls)
            return HostedSound(Mirrors(bases, fetcher, retry), fetcher, object_name)
        return HostedSound(place.mirrors(fetcher, retry), fetcher, place.reference)

    def read_captions(self, name: str) -> bytes:
        """The file of captions `name` of the stream, which was opened before, over a connection of
        its own. Blocks; for any thread. Raises a SwingsError."""
        place, retry = self._place, self._config.retry
        assert place is not None
        if isinstance(place, Path):
            return read_stream_file(open_place(place), name, MAX_CAPTIONS_BYTES)
        with closing(self._fetcher.another(self._fetcher.config)) as fetcher:
            if isinstance(place, ServedPlace):
                bases = tuple(f"{url}/" for url in place.urls)
                mirrors = Mirrors(bases, fetcher, retry)
            else:
                mirrors = place.mirrors(fetcher, retry)
            return bytes(mirrors.get(name, MAX_CAPTIONS_BYTES).data)

    def _find(self, fetcher: Fetcher) -> Place:
        if self._place is None:
            self._place = locate(self.name, fetcher)
        return self._place

    def _use(self) -> Fetcher:
        with self._lock:
            self._using = fetcher = self._fetcher.shared()
            if self._stopped:
                raise StoppedError(f"{self.name}: stopped")
        return fetcher

    def _open_patiently(
        self, fetcher: Fetcher, frames: FrameRange, layers: int | None, adaptive: bool
    ) -> Source:
        retry = Retry(self._config.retry)
        while True:
            try:
                return self._open(fetcher, frames, layers, adaptive)
            except BrokenError as error:
                if self._last is None:
                    raise  # a wrong address should be told at once
                fetcher.pause(retry.delay_s(error, time.monotonic(), random.random()))

    def _open(
        self, fetcher: Fetcher, frames: FrameRange, layers: int | None, adaptive: bool
    ) -> Source:
        place = self._find(fetcher)
        if isinstance(place, Path):
            return DirectorySource(place, frames, layers, max_gaussians=self._max_gaussians)
        # A known rate of the link is where the next estimate starts.
        last_play = self._last.play if self._last else NO_PLAY
        if isinstance(place, ServedPlace):
            retry = self._config.retry
            return ServedSource(
                self.name, place.urls, fetcher, frames, layers, retry, last_play, adaptive
            )
        chosen, rate_bps = adaptive and layers is None, last_play.rate_bps
        retry = self._config.retry
        return HostedSource(self.name, place, fetcher, frames, layers, retry, chosen, rate_bps)

    def _check(self, manifest: Manifest) -> None:
        check_gaussians(manifest, self._max_gaussians, self.name)
        before = self.manifest
        if before and not manifest.is_same_but_live(before):
            raise CorruptError(
                f"{self.name}: the stream was replaced by another one; play it again"
            )
        self.manifest = manifest

    def interrupt(self) -> None:
        """Makes a thread that opens or waits for packets, now or later, raise StoppedError soon."""
        with self._lock:
            self._stopped = True
            if self._using is not None:
                self._using.interrupt()

    def close(self) -> None:
        """Closes the connections. Close the sources first."""
        self._fetcher.close()


@contextmanager
def opened(
    source: str,
    frames: FrameRange | None = None,
    layers: int | None = None,
    via: tuple[str, int] | None = None,
    config: SourceConfig | None = None,
    adaptive: bool = False,
) -> Iterator[Source]:
    """The stream that `source` names, opened once; see `Opener.open`."""
    with (
        closing(Opener(source, via, config=config)) as opener,
        closing(opener.open(frames or FrameRange(), layers, adaptive)) as found,
    ):
        yield found
