"""A stream for scripts and notebooks: any frame as Gaussians, and as a picture from any camera.

with Scene.open("my-stream") as scene:
    picture = scene.render(30)
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import Self, TypeVar

from codec.arrays import Floats
from codec.camera import Camera
from codec.errors import CodecError, InvalidError
from codec.framerange import FrameRange
from codec.slice import Motion, Slice, window_births
from codec.splats import Splats
from codec.stream import StreamReader
from codec.stream.manifest import Manifest
from codec.stream.reader import DEFAULT_MAX_GAUSSIANS
from codec.stream.segment import INDEX_NAME
from player.render.cpu import render_depth, render_splats
from player.render.gl import create_renderer
from player.render.renderer import GlVersion, Renderer, RendererKind, check_drawable
from player.show.background import BLACK, Colour, on_background
from player.source.opener import SourceConfig, is_url
from player.source.sizelimits import SizeLimits
from player.source.source import check_layers
from player.source.webstorage import WebStorage

Choice = TypeVar("Choice", bound=StrEnum)


class Scene:
    """A stream that is open; use it in a `with` block, or close it.

    Frames may be asked for in any order; going forward is cheapest, as only what is new is fetched
    and decoded. One thread at a time may use it, and always the same one may `render`.
    """

    def __init__(
        self,
        reader: StreamReader,
        num_layers: int,
        kind: RendererKind,
        version: GlVersion,
        web: WebStorage | None,
    ) -> None:
        """Use `Scene.open`. web: is closed together with the scene."""
        self._reader = reader
        self._web = web
        self._kind, self._version = kind, version
        self._renderer: Renderer | None = None
        self._thread: int | None = None
        self._held = _Held(reader.manifest)
        self._closed = False
        self._motion: tuple[int, Motion] | None = None  # from a frame to the next one
        self.num_layers = num_layers
        """The layers that show."""

    @staticmethod
    def open(
        source: str | Path,
        *,
        layers: int | None = None,
        renderer: str | RendererKind = "auto",
        gl: str | GlVersion = "auto",
        delivery: SourceConfig | None = None,
        max_gaussians: int | None = DEFAULT_MAX_GAUSSIANS,
    ) -> Scene:
        """The stream that `source` names, as for swings-play: a folder, or the URL of a served
        stream or of one on any static host.

        layers: how many of each slice are fetched and shown; None takes all. renderer: auto, gl or
        cpu; it starts when the first picture is drawn. gl: the version of OpenGL: auto, 3.3 or 4.3.
        delivery: patience with the network, and where it may lead. max_gaussians: a stream of more
        Gaussians a frame is refused, because a few kilobytes can ask for gigabytes of memory; None
        takes any. Raises a SwingsError.
        """
        kind = _chosen(RendererKind, renderer, "renderer")
        version = _chosen(GlVersion, gl, "OpenGL version")
        web = WebStorage(str(source), delivery) if is_url(str(source)) else None
        try:
            reader = StreamReader(web or Path(source), max_gaussians)
            num_layers = check_layers(layers, reader.manifest, reader.name)
            scene = Scene(reader, num_layers, kind, version, web)
            scene._check_sizes(0)
            return scene
        except BaseException:
            if web is not None:
                web.close()
            raise

    @property
    def name(self) -> str:
        """Where the stream is, as it was named."""
        return self._reader.name

    @property
    def manifest(self) -> Manifest:
        return self._reader.manifest

    @property
    def fps(self) -> float:
        return self._reader.manifest.fps

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """Cameras of the stream, from the capture that it was trained on."""
        return self._reader.manifest.cameras

    @property
    def num_frames(self) -> int:
        """Frames there are: of a live stream as many as there were at the last `refresh`."""
        return self._reader.num_frames

    @property
    def renderer(self) -> str | None:
        """Name of the renderer, for people; None before the first picture."""
        return None if self._renderer is None else self._renderer.name

    def refresh(self) -> int:
        """Looks whether a live stream has grown; gives how many frames are new."""
        self._check_open()
        before, segments = self.num_frames, len(self._reader.records)
        self._reader.refresh()
        self._check_sizes(segments)
        return self.num_frames - before

    def _check_sizes(self, first_segment: int) -> None:
        """Raises CorruptError where a stranger's index names objects that are too long."""
        if self._web is None:
            return
        limits = SizeLimits(self.manifest)
        for record in self._reader.records[first_segment:]:
            try:
                limits.check_segment(record)
            except CodecError as error:
                raise error.within(self._web.place(INDEX_NAME)) from error

    def frames(self, first: int = 0, end: int | None = None) -> range:
        """The numbers of the frames first..end-1, as far as there are any. Raises InvalidError
        if there is none."""
        self._check_open()
        return FrameRange(first, end).of(self.num_frames, self.name)

    def splats(self, frame: float) -> Splats:
        """The Gaussians that show in `frame`, oldest slice first. Between two frames, as in frame
        30.5, those that go on are on their way, and others fade: see codec/slice.py. Raises
        InvalidError if there is no such frame, a CodecError for a broken stream, a FetchError if it
        cannot be fetched."""
        first, share = self._split(frame)
        if not share:
            return self._reader.active_splats(first, self.num_layers)
        if self._motion is None or self._motion[0] != first:
            self._motion = first, self._reader.motion(first, first + 1, self.num_layers)
        return self._motion[1].all_at(share)

    def camera(
        self, camera: Camera | str | None = None, size: tuple[int, int] | None = None
    ) -> Camera:
        """The camera that `render` takes for these arguments. Raises InvalidError for the name of
        one that the stream does not know."""
        found = camera if isinstance(camera, Camera) else self.manifest.camera(camera)
        return found if size is None else found.fitted(*size)

    def render(
        self,
        frame: float,
        camera: Camera | str | None = None,
        size: tuple[int, int] | None = None,
        *,
        background: Colour | None = BLACK,
    ) -> Floats:
        """(H, W, 3) float32 picture of `frame`, row 0 on top, `background` where nothing is, not
        clamped above 1. Where `background` is None, (H, W, 4) with straight alpha. The CPU draws
        what lies between two frames, such as frame 30.5.

        camera: the name of one of the stream's, or any other; None takes the default one. size:
        width and height in pixels; what the camera sees is fitted into it. Raises what `splats`
        raises, UnsupportedError for a stream that would be drawn wrongly, and GlError where the
        scene was opened with `gl` and OpenGL cannot start.
        """
        first, share = self._split(frame)
        seen, alpha = self.camera(camera, size), background != BLACK
        if share:
            check_drawable(self.manifest)
            near_m = self.manifest.near_of(seen)
            picture = render_splats(self.splats(frame), seen, near_m, alpha)
            return on_background(picture, background) if alpha else picture
        renderer = self._drawing()
        try:
            for slice in self._missing(first):
                renderer.put(slice)
            renderer.alpha = alpha
            picture = renderer.render(first, seen)
            return on_background(picture, background) if alpha else picture
        except BaseException:
            # What it holds by now is not known; the next picture starts with another one.
            self._stop_drawing()
            raise

    def depth(
        self,
        frame: float,
        camera: Camera | str | None = None,
        size: tuple[int, int] | None = None,
    ) -> Floats:
        """(H, W) float32 depth of what shows in `frame`, metres along the viewing axis; NaN where
        Gaussians cover less than half of a pixel. The CPU draws it. camera, size: as in `render`.
        """
        seen = self.camera(camera, size)
        return render_depth(self.splats(frame), seen, self.manifest.near_of(seen))

    def _drawing(self) -> Renderer:
        """The renderer, which belongs to the thread that draws first."""
        if self._renderer is None:
            self._renderer = create_renderer(self._kind, self.manifest, self._version)
            self._thread = threading.get_ident()
        elif self._thread != threading.get_ident():
            raise InvalidError(
                f"{self.name}: another thread already draws this scene; open a scene per thread"
            )
        return self._renderer

    def _missing(self, frame: int) -> Iterator[Slice]:
        """The slices that the renderer lacks to draw `frame`, oldest first."""
        births = self._held.missing(frame)
        if len(births) == self.manifest.swin_size:
            yield from self._reader.window(frame, self.num_layers)
        else:
            for birth in births:
                yield self._reader.slice(birth, self.num_layers)

    def _stop_drawing(self) -> None:
        renderer, self._renderer, self._thread = self._renderer, None, None
        self._held.clear()
        if renderer is not None:
            renderer.close()

    def _split(self, frame: float) -> tuple[int, float]:
        """The frame at or before `frame`, and the share of the way to the next one."""
        self._check_open()
        if not 0 <= frame <= self.num_frames - 1:
            raise InvalidError(
                f"{self.name} has {self.num_frames} frames; there is no frame {frame}"
            )
        share, first = math.modf(frame)
        return int(first), share

    def _check_open(self) -> None:
        if self._closed:
            raise InvalidError(f"{self.name}: the scene is closed; open it again")

    def close(self) -> None:
        """Frees everything; closing twice is the same as once."""
        self._closed = True
        self._stop_drawing()
        if self._web is not None:
            self._web.close()

    def __repr__(self) -> str:
        state = "closed" if self._closed else self._reader.summary(self.num_layers)
        return f"<Scene {self.name}: {state}>"

    def __enter__(self) -> Self:
        self._check_open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _chosen(kinds: type[Choice], name: str, what: str) -> Choice:
    """The one of `kinds` that is called `name`. Raises InvalidError."""
    try:
        return kinds(name)
    except ValueError as error:
        raise InvalidError(f"{what} {name!r} is not one of {', '.join(kinds)}") from error


class _Held:
    """Which slices a renderer holds, lane by lane."""

    def __init__(self, manifest: Manifest) -> None:
        self._manifest = manifest
        self._births: dict[int, int] = {}  # by lane
        self._frame = 0

    def missing(self, frame: int) -> list[int]:
        """The births of the slices of the window of `frame` that are not held, oldest first; they
        are from now on."""
        swin_size = self._manifest.swin_size
        if frame < self._frame:
            # A slice from before a keyframe is known only as far as it shows behind that.
            self.clear()
        self._frame = frame
        window = window_births(frame, swin_size)
        births = [birth for birth in window if self._births.get(birth % swin_size) != birth]
        self._births.update((birth % swin_size, birth) for birth in births)
        return births

    def clear(self) -> None:
        self._births.clear()
