"""One stream, opened again and again: at other frames, in other layers.

Rule: what was learnt once is not asked for again: where the stream is, its manifest, the
connections to its host, and what the server knows of the link.
"""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from codec.errors import CorruptError
from codec.framerange import FrameRange
from codec.storage.credentials import without_credentials
from codec.stream.captions import MAX_CAPTIONS_BYTES
from codec.stream.manifest import Manifest, object_name
from codec.stream.packedstorage import open_place
from codec.stream.reader import DEFAULT_MAX_GAUSSIANS, check_gaussians, read_stream_file
from player.network.faults import BrokenError, StoppedError
from player.network.fetch import FetchConfig, Fetcher
from player.network.mirrors import Mirrors
from player.network.requesttarget import logins_of
from player.network.retry import Retry, RetryConfig

from .directory import DirectorySource
from .hosted import HostedSource
from .locate import Place, ServedPlace, locate, split_source
from .preview import Preview, load_preview
from .served import ServedSource
from .soundfiles import FolderSound, HostedSound, SoundFiles
from .source import NO_PLAY, Source


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
