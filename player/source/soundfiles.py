"""Readers of a stream's objects of sound: from its folder, or from its hosts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from codec.stream.manifest import object_name
from codec.stream.packedstorage import open_place
from codec.stream.reader import read_stream_file
from codec.stream.sound import MAX_SOUND_BYTES, SoundSource
from player.network.fetch import Fetcher
from player.network.mirrors import Mirrors


class SoundFiles(Protocol):
    """Belongs to one thread; `interrupt` may come from any."""

    @property
    def received_bytes(self) -> int:
        """Bytes read so far."""
        ...

    def read(self, segment: int, source: SoundSource) -> bytes:
        """The object of `source` in `segment`, unchecked. Raises a SwingsError."""
        ...

    def interrupt(self) -> None:
        """Makes a thread that waits, now or later, raise StoppedError soon."""
        ...

    def close(self) -> None: ...


class FolderSound:
    """Objects in a stream's folder."""

    def __init__(self, path: Path) -> None:
        self._storage = open_place(path)
        self.received_bytes = 0

    def read(self, segment: int, source: SoundSource) -> bytes:
        data = read_stream_file(self._storage, object_name(segment, source.part), MAX_SOUND_BYTES)
        self.received_bytes += len(data)
        return data

    def interrupt(self) -> None:
        pass

    def close(self) -> None:
        pass


class HostedSound:
    """Objects on the hosts of `mirrors`, by a fetcher of its own."""

    def __init__(
        self, mirrors: Mirrors, fetcher: Fetcher, reference: Callable[[int, str], str]
    ) -> None:
        """fetcher: the one of `mirrors`; is closed together with this. reference: gives what a
        segment's object is called there."""
        self._mirrors, self._fetcher, self._reference = mirrors, fetcher, reference

    @property
    def received_bytes(self) -> int:
        return self._fetcher.received_bytes

    def read(self, segment: int, source: SoundSource) -> bytes:
        reference = self._reference(segment, source.part)
        return bytes(self._mirrors.get(reference, MAX_SOUND_BYTES).data)

    def interrupt(self) -> None:
        self._fetcher.interrupt()

    def close(self) -> None:
        self._fetcher.close()
