"""One stream that is served, from the moment that it was found until it is gone or another."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from itertools import count

from codec.errors import CodecError
from codec.storage.storage import Stamp, Storage
from codec.stream.captions import MAX_CAPTIONS_BYTES
from codec.stream.integrity import CheckedObject
from codec.stream.manifest import Part, object_name
from codec.stream.pictures import read_picture
from codec.stream.reader import read_stream_file
from codec.stream.sound import MAX_SOUND_BYTES, SoundObject
from codec.stream.streampacker import StreamPacker
from server.abr.media import SegmentSizes, segment_sizes

from .streamview import StreamView

_generations = count(1)

LIVE_POLL_S = 0.05
"""Seconds between two looks at a stream while a task waits for its growth."""


class Growth:
    """Waiting for a live stream to grow; lives on an event loop.

    The stream is polled only while a task waits, and by one poller however many tasks wait.
    """

    def __init__(self, look: Callable[[], Awaitable[None]]) -> None:
        """look: looks at the stream, and calls `wake` if it has changed."""
        self._look = look
        self._woken = asyncio.Event()
        self._poller: asyncio.Task[None] | None = None
        self.num_waiting = 0

    def wake(self) -> None:
        """Lets all waiting tasks check their conditions."""
        self._woken.set()
        self._woken = asyncio.Event()

    async def wait(self, is_over: Callable[[], bool], timeout_s: float) -> None:
        """Returns when `is_over`, or after `timeout_s`."""
        if not self.num_waiting:
            self._woken = asyncio.Event()  # one belongs to the loop on which it was waited for
            self._poller = asyncio.create_task(self._poll())
        self.num_waiting += 1
        try:
            async with asyncio.timeout(timeout_s):
                while not is_over():
                    await self._woken.wait()
        except TimeoutError:
            pass
        finally:
            self.num_waiting -= 1
            if not self.num_waiting and self._poller is not None:
                self._poller.cancel()
                self._poller = None

    async def _poll(self) -> None:
        while True:
            await self._look()
            await asyncio.sleep(LIVE_POLL_S)


async def _no_refresh() -> None:
    pass


class ServedStream:
    """A stream of the library; also the `Media` of a session.

    It only grows. Where another stream takes its place, that is another object, and this one is
    `gone`.
    """

    def __init__(
        self,
        name: str,
        storage: Storage,
        view: StreamView,
        look: Callable[[], Awaitable[None]] = _no_refresh,
    ) -> None:
        """look: looks at the files of this one, and calls `announce`."""
        self.name = name
        self.generation = next(_generations)
        """No other object of this process has the same."""
        self.view = view
        self.gone = False
        """Whether it is served no more; what was read of it is still right."""
        self._storage = storage
        self._sizes: dict[int, SegmentSizes] = {}
        self._growth = Growth(look)
        self._announced = view

    def announce(self, gone: bool = False) -> None:
        """Wakes the tasks that wait for growth if the view has changed; on the event loop."""
        if gone or self._announced is not self.view:
            self.gone = self.gone or gone
            self._announced = self.view
            self._growth.wake()

    async def wait_for_growth(self, num_segments: int, timeout_s: float) -> None:
        """Returns when the stream has more than `num_segments`, when it is not live any more, when
        it is gone, or after `timeout_s`."""

        def is_over() -> bool:
            return self.gone or not self.live or self.view.num_segments > num_segments

        if not is_over():
            await self._growth.wait(is_over, timeout_s)

    @property
    def fps(self) -> float:
        return self.view.manifest.fps

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
    def num_layers(self) -> int:
        return self.view.manifest.num_layers

    def has_object(self, segment: int, part: Part) -> bool:
        view = self.view
        return 0 <= segment < view.num_segments and part in view.manifest.parts

    def object_bytes(self, segment: int, part: Part) -> int:
        view = self.view
        return view.records[segment].part_bytes[view.manifest.part_number(part)]

    def object_sha256(self, segment: int, part: Part) -> str:
        view = self.view
        return view.records[segment].part_sha256[view.manifest.part_number(part)].hex()

    def births(self, segment: int) -> range:
        """The births of the slices in `segment`."""
        view = self.view
        return view.manifest.births(segment, view.records[segment].num_frames)

    def sizes(self, birth: int) -> SegmentSizes:
        """Sizes of the segment of `birth`, from the index."""
        view = self.view
        segment = view.manifest.segment_of(birth)
        found = self._sizes.get(segment)
        if found is None:
            found = segment_sizes(view.records[segment], view.manifest)
            self._sizes[segment] = found
        return found

    def read_object(self, segment: int, part: Part) -> CheckedObject:
        """The object, checked against the index. Blocks. Raises a CodecError that names it."""
        view, path = self.view, object_name(segment, part)
        data = read_stream_file(self._storage, path, self.object_bytes(segment, part))
        place = self._storage.place(path)
        return CheckedObject.check(place, data, view.manifest, view.records[segment], part)

    def has_sound(self, segment: int, name: str) -> bool:
        """Whether `name` is that of an object of sound in `segment`."""
        view = self.view
        sources = view.manifest.sound
        return 0 <= segment < view.num_segments and any(name == each.part for each in sources)

    def read_sound(self, segment: int, name: str) -> bytes:
        """The object of sound, checked by its own checksum. Blocks. Raises a CodecError that names
        it."""
        path = object_name(segment, name)
        data = read_stream_file(self._storage, path, MAX_SOUND_BYTES)
        try:
            SoundObject.parse(data)
        except CodecError as error:
            raise error.within(self._storage.place(path)) from error
        return data

    def sound_stamp(self, segment: int, name: str) -> Stamp | None:
        """What changes when another sound takes the name. Blocks. Raises UnreadableError."""
        return self._storage.stamp(object_name(segment, name))

    def packer(self) -> StreamPacker:
        """The stream as one file, if it is finished. Blocks. Raises a CodecError."""
        view = self.view
        arguments = view.manifest, view.manifest_json, view.records, view.index_data
        return StreamPacker(self._storage, *arguments)

    def read_captions(self, path: str) -> bytes | None:
        """The file of captions at `path`; None for one that the manifest does not name, or that is
        too large or is gone. Blocks."""
        if all(path != each.file_name for each in self.view.manifest.captions):
            return None
        stamp = self._storage.stamp(path)
        if stamp is None or stamp.size_bytes > MAX_CAPTIONS_BYTES:
            return None
        return self._storage.read(path, MAX_CAPTIONS_BYTES)

    def has_picture(self, path: str) -> bool:
        """Whether there is a picture at `path`. Blocks."""
        return bool(path) and self._storage.stamp(path) is not None

    def read_picture(self, path: str) -> bytes | None:
        """The picture at `path`; None while there is none, and for a path that the manifest does
        not name. Blocks."""
        manifest = self.view.manifest
        if path not in (manifest.poster, manifest.storyboard):
            return None
        return read_picture(self._storage, path)
