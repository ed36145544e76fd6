"""The streams that are served: a table of names, never a way from a URL to a file.

Rule: a request finds a stream by its name in the table and an object by its place in the index.
"""

from __future__ import annotations

import asyncio
import hashlib
import logging
import re
from dataclasses import dataclass
from itertools import count
from pathlib import Path

from codec.errors import SwingsError
from codec.stream.index import pack_record
from codec.stream.integrity import CheckedObject
from codec.stream.manifest import MANIFEST_NAME, Manifest, Part
from codec.stream.poster import read_poster
from codec.stream.reader import StreamReader
from server.abr.media import SegmentSizes, segment_sizes

from .errors import ServerError

log = logging.getLogger(__name__)

_GENERATIONS = count()

STREAM_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,79}")
"""What a stream may be called: it needs no quoting in a URL, a metric or a page."""


@dataclass(frozen=True, slots=True)
class StreamView:
    """What a stream holds at one time; whoever has a view sees no half-done refresh."""

    manifest: Manifest
    manifest_json: bytes
    manifest_sha256: str
    num_segments: int
    num_frames: int
    index_data: bytes
    index_sha256: str


class ServedStream:
    """One stream of the library; also the `Media` of a session."""

    def __init__(self, folder: Path) -> None:
        self.name = folder.name
        self.generation = next(_GENERATIONS)
        self.gone = False
        self.refreshed_s = 0.0
        self.lock = asyncio.Lock()
        self.trouble = ""
        """Why the last refresh that failed did so; logged once."""
        self._folder = folder
        self._index_hash = hashlib.sha256()
        self._num_hashed = 0
        self._sizes: dict[int, SegmentSizes] = {}
        self._reader = StreamReader(folder)
        self.view = self._look()

    def _look(self) -> StreamView:
        manifest, manifest_json = self._reader.manifest, self._reader.manifest_json
        records = self._reader.records
        for record in records[self._num_hashed :]:
            self._index_hash.update(pack_record(record))
        self._num_hashed = len(records)
        return StreamView(
            manifest=manifest,
            manifest_json=manifest_json,
            manifest_sha256=hashlib.sha256(manifest_json).hexdigest(),
            num_segments=len(records),
            num_frames=self._reader.num_frames,
            index_data=b"".join(map(pack_record, records)),
            index_sha256=self._index_hash.hexdigest(),
        )

    def refresh(self) -> None:
        """Takes in what was appended. Blocks; where it raises the view stays the last good one."""
        self._reader.refresh()
        self.view = self._look()

    @property
    def fps(self) -> float:
        return self.view.manifest.fps

    @property
    def swin_size(self) -> int:
        return self.view.manifest.swin_size

    @property
    def segment_frames(self) -> int:
        return self.view.manifest.segment_frames

    @property
    def num_frames(self) -> int:
        return self.view.num_frames

    @property
    def live(self) -> bool:
        return self.view.manifest.live

    @property
    def has_slots(self) -> bool:
        return self.view.manifest.has_slots

    @property
    def num_layers(self) -> int:
        return self.view.manifest.num_layers

    def has_object(self, segment: int, part: Part) -> bool:
        view = self.view
        return 0 <= segment < view.num_segments and part in view.manifest.parts

    def object_bytes(self, segment: int, part: Part) -> int:
        number = self.view.manifest.part_number(part)
        return self._reader.records[segment].part_bytes[number]

    def object_sha256(self, segment: int, part: Part) -> str:
        number = self.view.manifest.part_number(part)
        return self._reader.records[segment].part_sha256[number].hex()

    def births(self, segment: int) -> range:
        """The births of the slices in `segment`."""
        return self.view.manifest.births(segment, self._reader.records[segment].num_frames)

    def sizes(self, birth: int) -> SegmentSizes:
        """What the index says of the segment of `birth`."""
        segment = self.view.manifest.segment_of(birth)
        found = self._sizes.get(segment)
        if found is None:
            found = segment_sizes(self._reader.records[segment], self.view.manifest)
            self._sizes[segment] = found
        return found

    def read_object(self, segment: int, part: Part) -> CheckedObject:
        """The object, checked against the index. Blocks."""
        return self._reader.read_object(segment, part)

    def read_poster(self) -> bytes | None:
        """The stream's poster; None while there is none. Blocks."""
        return read_poster(self._folder, self.view.manifest)

    async def wait_for_growth(self, num_segments: int, timeout_s: float) -> None:
        """Returns when there are more segments, or the time is over."""
        loop = asyncio.get_running_loop()
        until_s = loop.time() + timeout_s
        while self.view.num_segments <= num_segments and self.live and loop.time() < until_s:
            await asyncio.sleep(0.05)
            await asyncio.to_thread(self.refresh)


class Library:
    """The streams below a root that is a stream itself, or a folder of streams.

    Raises ServerError or CodecError at construction, naming what is wrong.
    """

    def __init__(self, root: Path, refresh_s: float) -> None:
        self._root = root.resolve()
        self._refresh_s = refresh_s
        self._scanned_s = 0.0
        self._lock = asyncio.Lock()
        self._refused: set[str] = set()
        self.broken: dict[str, str] = {}
        if not self._root.is_dir():
            raise ServerError(f"{root} is not a folder; name a stream or a folder of streams")
        self._single = (self._root / MANIFEST_NAME).exists()
        folders = [self._root] if self._single else self._folders()
        if not folders:
            raise ServerError(
                f"{root} holds no stream: no {MANIFEST_NAME} in it or one level below"
            )
        self.streams = {folder.name: _open(folder) for folder in folders}

    def _folders(self) -> list[Path]:
        found = (path.parent for path in self._root.glob(f"*/{MANIFEST_NAME}"))
        return sorted(path for path in found if not path.name.startswith("."))

    async def look(self) -> None:
        now_s = asyncio.get_running_loop().time()
        await self.rescan(now_s)
        for stream in self.streams.values():
            await self.refresh(stream, now_s)

    async def watch(self) -> None:
        while True:
            await self.look()
            await asyncio.sleep(self._refresh_s)

    async def find(self, name: str, now_s: float) -> ServedStream | None:
        """The stream called `name`, as it is now; None where there is none."""
        stream = self.streams.get(name)
        if stream is None and not self._single:
            await self.rescan(now_s)
            stream = self.streams.get(name)
        if stream is not None:
            await self.refresh(stream, now_s)
        return stream

    async def refresh(self, stream: ServedStream, now_s: float) -> None:
        """Follows a live stream, at most once every refresh_s however many ask."""
        if not stream.live or now_s - stream.refreshed_s < self._refresh_s:
            return
        async with stream.lock:
            if now_s - stream.refreshed_s >= self._refresh_s:
                stream.refreshed_s = now_s
                try:
                    await asyncio.to_thread(stream.refresh)
                except (SwingsError, OSError) as error:
                    # What was there before it broke can still be served.
                    if str(error) != stream.trouble:
                        log.warning("%s grows no more: %s", stream.name, error)
                    stream.trouble = str(error)

    async def rescan(self, now_s: float) -> None:
        """Takes in streams that are new in the folder, at most once every refresh_s."""
        async with self._lock:
            if not self._single and now_s - self._scanned_s >= self._refresh_s:
                self._scanned_s = now_s
                self.streams |= await asyncio.to_thread(self._open_new)

    def _open_new(self) -> dict[str, ServedStream]:
        opened = {}
        for folder in self._folders():
            if folder.name in self.streams or folder.name in self._refused:
                continue
            try:
                opened[folder.name] = _open(folder)
            except (SwingsError, OSError) as error:
                self._refused.add(folder.name)
                log.warning("not served: %s", error)
        return opened


def _open(folder: Path) -> ServedStream:
    if not STREAM_NAME.fullmatch(folder.name):
        raise ServerError(
            f"{folder}: a stream's folder is called by letters, digits, '.', '_' and '-'; rename it"
        )
    return ServedStream(folder)
