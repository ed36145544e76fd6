"""A stream for scripts and notebooks: any frame as arrays.

import codec
stream = codec.open_stream("my-stream")
splats = stream.frame(12)
"""

from __future__ import annotations

from collections.abc import Iterator
from operator import index
from pathlib import Path
from typing import Self

from codec.camera import Camera
from codec.errors import InvalidError
from codec.splats import Splats
from codec.storage.objectstore import without_credentials
from codec.storage.openstorage import Place
from codec.stream.manifest import Manifest
from codec.stream.reader import DEFAULT_MAX_GAUSSIANS, StreamReader


def open_stream(place: Place, *, max_gaussians: int | None = DEFAULT_MAX_GAUSSIANS) -> OpenedStream:
    """The stream at `place`: a folder, as str or Path, or a URL in an object store, such as
    s3://BUCKET/STREAM. Only its manifest and its index are read.

    max_gaussians: most Gaussians a frame, because a stream of a few kilobytes can ask for
    gigabytes of memory; None takes any. Raises a SwingsError: InvalidError for another kind of URL,
    CorruptError for what is not a stream, UnsupportedError for a stream of more than
    `max_gaussians`; for a folder that does not exist a MissingFolderError, which is a
    FileNotFoundError, too.
    """
    return OpenedStream(place, max_gaussians)


class OpenedStream:
    """A stream that is open. Closing it, or leaving its `with` block, frees what was read.

    One thread at a time. Any order of frames is exact; going forward is cheapest.
    """

    def __init__(self, place: Place, max_gaussians: int | None) -> None:
        """Use `open_stream`."""
        if not isinstance(place, Path) and str(place).lower().startswith(("http://", "https://")):
            name = without_credentials(str(place))
            raise InvalidError(
                f"{name}: codec reads folders and object stores; use player.Scene.open "
                "for this kind of URL"
            )
        self._reader: StreamReader | None = StreamReader(place, max_gaussians)
        self.name = self._reader.name

    @property
    def manifest(self) -> Manifest:
        """All that is fixed for the whole stream."""
        return self._open().manifest

    @property
    def num_frames(self) -> int:
        """Frames that there are; `refresh` may find more in a live stream."""
        return self._open().num_frames

    @property
    def num_layers(self) -> int:
        return self.manifest.num_layers

    @property
    def fps(self) -> float:
        """Frames per second."""
        return self.manifest.fps

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The cameras of the capture, OpenCV poses from world to camera, metres."""
        return self.manifest.cameras

    def camera(self, name: str | None = None) -> Camera:
        """The one called `name`; without a name the stream's default. Raises InvalidError."""
        return self.manifest.camera(name)

    def frame(self, frame: int, layers: int | None = None) -> Splats:
        """The Gaussians that show in `frame`, frames count from 0.

        layers: only the so many most important layers of every slice; None takes all. Raises
        InvalidError for a frame or layers that there are not, CorruptError for damaged files.
        """
        return self._open().active_splats(frame, self.num_layers if layers is None else layers)

    def __getitem__(self, frame: int) -> Splats:
        """`stream[30]` is `frame(30)`, and `stream[-1]` the last frame that there is now."""
        frame = index(frame)
        return self.frame(frame + self.num_frames if frame < 0 else frame)

    def __repr__(self) -> str:
        if self._reader is None:
            return f"<OpenedStream {self.name}: closed>"
        return f"<OpenedStream {self.name}: {self._reader.summary(self.num_layers)}>"

    def __len__(self) -> int:
        return self.num_frames

    def __iter__(self) -> Iterator[Splats]:
        """Frame after frame, all layers, to the last one that there is when it is reached."""
        frame = 0
        while frame < self.num_frames:
            yield self.frame(frame)
            frame += 1

    def refresh(self) -> int:
        """Takes in what a live stream has grown by; gives how many frames are new."""
        before = self.num_frames
        self._open().refresh()
        return self.num_frames - before

    def _open(self) -> StreamReader:
        if self._reader is None:
            raise InvalidError(f"{self.name}: the stream is closed; open it again")
        return self._reader

    def close(self) -> None:
        """Frees what was read; closing twice is the same as once."""
        self._reader = None

    def __enter__(self) -> Self:
        self._open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
