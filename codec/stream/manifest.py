"""manifest.json: what a player must know before the first slice; of constant size.

Rule: a `Manifest` that exists is valid, whether it came from JSON or from a program.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from codec.camera import MAX_NAME_CHARS, Camera
from codec.errors import CorruptError, InvalidError, UnsupportedError
from codec.lattice.lattice import Lattice
from codec.slice import window_births
from codec.slots.slotlayout import MAX_LAYERS as MAX_LAYERS
from codec.slots.slotlayout import SlotLayout

from .captions import Captions, captions_of, check_captions
from .manifestjson import lattice_of, lattice_to_json, number, parse_manifest, typed
from .sound import SoundSource, check_sources, sources_of

VERSION = 1
"""Of the format, in the manifest and in every object."""

MANIFEST_NAME = "manifest.json"
SEGMENTS_NAME = "segments"
"""The folder of the objects."""

OBJECT_URL = f"{SEGMENTS_NAME}/{{segment}}/{{layer}}"
"""Where the objects are fetched by URL unless the manifest names another place."""

MAX_MANIFEST_BYTES = 1 << 20
"""Longest manifest.json read, in bytes; 256 cameras need about 200 KB."""

MAX_CAMERAS = 256
MIN_FPS, MAX_FPS = 0.001, 1000
"""Frames shown in a second: at the least one in 1000 seconds."""

MAX_TEXT_CHARS = MAX_NAME_CHARS

MAX_POSTER_BYTES = 255
"""Longest path of a poster or storyboard, in UTF-8: what file systems take as one name."""

Point = tuple[float, float, float]


SKIP_MAPS = "skipmaps"
"""The part of a segment that holds the skip maps of its slices."""

Part = int | str
"""The parts of a segment, an object each: the number of a layer, MASKS, or `keyframe_part`."""


def keyframe_part(layer: int) -> str:
    """The part of a segment that is the keyframe of `layer`."""
    return f"keyframe-{layer}"


def is_keyframe(part: Part) -> bool:
    """Whether `part` is what `keyframe_part` gives."""
    return type(part) is str and part != SKIP_MAPS


def layer_of(part: Part) -> int:
    """The layer that `part` belongs to; 0 for the skip maps."""
    return part if isinstance(part, int) else int(part.partition("-")[2] or 0)


def object_name(segment: int, part: Part) -> str:
    """Where the object of (segment, part) lies in a stream's folder.

    Always there: the `object_url` of a manifest is only for fetching by URL.
    """
    return f"{SEGMENTS_NAME}/{segment}/{part}"


def object_file(stream: Path, segment: int, part: Part) -> Path:
    """Where the object of (segment, part) lies if the folder is `stream`."""
    return stream / object_name(segment, part)


@dataclass(frozen=True, slots=True)
class Manifest:
    """Everything about a stream that does not grow with its length.

    Raises InvalidError at construction when a value breaks a rule.
    """

    fps: float
    """Frames shown in a second, MIN_FPS to MAX_FPS."""
    swin_size: int
    """Lanes, and the slices in a window: every so many frames a slot of a lane may change."""
    slots: tuple[int, ...]
    """Slots of a lane in each layer."""
    lattice: tuple[Lattice, ...]
    """The lattice of each layer."""
    segment_frames: int
    """Frames in a segment; the last one may have fewer."""
    sh_degree: int
    """Degree of the spherical harmonics, 0 to 3."""
    antialias: bool
    """Whether the renderer compensates opacity for its low-pass filter."""
    near_m: float
    """Nearest depth drawn, in metres."""
    bounds: tuple[Point, Point]
    """Lower and upper corner of what is worth looking at, in metres."""
    cameras: tuple[Camera, ...]
    """The capture's cameras, at least one."""
    default_camera: str
    """Name of the camera that a player starts from."""
    live: bool
    """Whether more segments may still come."""
    poster: str | None = None
    """Relative path of a still picture, if there is one."""
    storyboard: str | None = None
    """Relative path of a picture of small pictures, if there is one."""
    object_url: str = OBJECT_URL
    """Where an object is fetched, relative to the manifest."""
    title: str = ""
    """A name for people."""
    capture_frame: int = 0
    """Frame of the capture that frame 0 shows."""
    sound: tuple[SoundSource, ...] = ()
    """The sources of sound, in objects of their own."""
    camera_near_m: tuple[float, ...] = ()
    """Nearest depth drawn at each of the cameras, in metres; empty where it is `near_m` at all."""
    captions: tuple[Captions, ...] = ()
    """Captions, in files of their own."""
    view: Camera | None = None
    """The camera that a player starts from in place of `default_camera`, chosen by an edit."""
    focus: Point | None = None
    """The middle of what moves, metres: what is to be in a picture too narrow for all."""

    def __post_init__(self) -> None:
        _ = self.slot_layout  # has rules of its own
        self._check_sizes()
        self._check_view()
        self._check_cameras()
        self._check_texts()
        check_sources(self.sound)
        check_captions(self.captions)

    def _check_sizes(self) -> None:
        if not MIN_FPS <= self.fps <= MAX_FPS:
            raise InvalidError(f"manifest: fps {self.fps} is not in {MIN_FPS}..{MAX_FPS}")
        if not 0 <= self.capture_frame < 1 << 31:
            raise InvalidError(f"manifest: capture_frame {self.capture_frame} is out of range")

    def _check_view(self) -> None:
        if not (math.isfinite(self.near_m) and self.near_m > 0):
            raise InvalidError(f"manifest: near_m {self.near_m} is not positive")
        if self.camera_near_m and len(self.camera_near_m) != len(self.cameras):
            raise InvalidError(
                f"manifest: camera_near_m has {len(self.camera_near_m)} numbers for "
                f"{len(self.cameras)} cameras"
            )
        if not all(math.isfinite(near_m) and near_m > 0 for near_m in self.camera_near_m):
            raise InvalidError("manifest: camera_near_m holds a number that is not positive")
        corners = np.array(self.bounds, np.float64)
        if corners.shape != (2, 3) or not np.isfinite(corners).all():
            raise InvalidError("manifest: bounds are not two corners of three numbers")
        if (corners[0] > corners[1]).any():
            raise InvalidError("manifest: the lower corner of the bounds is above the upper one")
        if self.focus is not None and not np.isfinite(self.focus).all():
            raise InvalidError("manifest: focus holds a number that is not finite")

    def _check_cameras(self) -> None:
        if not 1 <= len(self.cameras) <= MAX_CAMERAS:
            raise InvalidError(f"manifest: {len(self.cameras)} cameras, not 1..{MAX_CAMERAS}")
        names = {camera.name for camera in self.cameras}
        if len(names) != len(self.cameras):
            raise InvalidError("manifest: two cameras have the same name")
        if self.default_camera not in names:
            raise InvalidError(f"manifest: no camera is called {self.default_camera[:80]!r}")

    def _check_texts(self) -> None:
        names = (camera.name for camera in (*self.cameras, *filter(None, (self.view,))))
        pictures = {"poster": self.poster or "", "storyboard": self.storyboard or ""}
        for text in (*pictures.values(), self.object_url, self.title, *names):
            if len(text) > MAX_TEXT_CHARS:
                raise InvalidError(f"manifest: a text of {len(text)} characters")
            if not _is_unicode(text):
                raise InvalidError(f"manifest: {text[:40]!a} holds half a surrogate pair")
        for key, path in pictures.items():
            if len(path.encode()) > MAX_POSTER_BYTES or any(c < " " or c == "\x7f" for c in path):
                raise InvalidError(
                    f"manifest: {key} {path[:40]!a} is longer than {MAX_POSTER_BYTES} bytes or "
                    "holds a control character"
                )
        if sorted(re.findall(r"\{.*?\}", self.object_url)) != ["{layer}", "{segment}"]:
            raise InvalidError(
                f"manifest: object_url {self.object_url!r} does not hold {{segment}} and {{layer}}"
            )

    @property
    def slot_layout(self) -> SlotLayout:
        """The layout by which skip maps, changes and keyframes are coded."""
        try:
            return SlotLayout(
                self.swin_size, self.slots, self.sh_degree, self.lattice, self.segment_frames
            )
        except InvalidError as error:
            raise InvalidError(f"manifest: {error}") from error

    @property
    def parts(self) -> tuple[Part, ...]:
        """The parts that each segment has an object of, in the order of the index."""
        layers = range(self.num_layers)
        return (*layers, SKIP_MAPS, *map(keyframe_part, layers))

    def part_number(self, part: Part) -> int:
        """The place of `part` in `parts`. Raises InvalidError if it has none."""
        if part not in self.parts:
            raise InvalidError(f"a segment has no part {part!r}; it has {len(self.parts)} parts")
        return self.parts.index(part)

    def max_content_bytes(self, part: Part) -> int:
        """Bytes of the largest chunk that a packet of `part` can hold."""
        layout, number = self.slot_layout, self.part_number(part)
        if part == SKIP_MAPS:
            return layout.max_skip_map_bytes
        if number < self.num_layers:
            return layout.max_change_bytes(number)
        return layout.max_keyframe_bytes(number - self.num_layers - 1)

    @property
    def slice_size(self) -> int:
        """Gaussians in a slice, at most."""
        return sum(self.slots)

    @property
    def num_gs(self) -> int:
        """Gaussians active in a frame, at most."""
        return self.swin_size * self.slice_size

    @property
    def layers(self) -> tuple[float, ...]:
        """Share of a slice's Gaussians in each layer; their sum is 1."""
        return tuple(count / self.slice_size for count in self.slots)

    @property
    def num_layers(self) -> int:
        return len(self.slots)

    @property
    def first_birth(self) -> int:
        """Birth of the oldest slice in the window of frame 0."""
        return window_births(0, self.swin_size).start

    def camera(self, name: str | None = None) -> Camera:
        """The camera called `name`, or the one that a player starts from. Raises InvalidError if
        there is none."""
        if name is None and self.view is not None:
            return self.view
        wanted = self.default_camera if name is None else name
        for camera in self.cameras:
            if camera.name == wanted:
                return camera
        raise InvalidError(
            f"no camera is called {wanted!r}; there are {', '.join(c.name for c in self.cameras)}"
        )

    def near_of(self, camera: Camera) -> float:
        """Nearest depth drawn in the view of `camera`, any camera, in metres.

        Where a camera of the stream stands it is that camera's own. With each metre away from the
        nearest of them it comes a metre closer to `near_m`, so that nothing pops up on the way.
        """
        if not self.camera_near_m:
            return self.near_m
        positions = np.array([own.position for own in self.cameras])
        distances_m = np.linalg.norm(positions - camera.position, axis=1)
        nearest = int(np.argmin(distances_m))
        own_m, away_m = self.camera_near_m[nearest], float(distances_m[nearest])
        if own_m < self.near_m:
            return min(own_m + away_m, self.near_m)
        return max(own_m - away_m, self.near_m)

    @property
    def least_near_m(self) -> float:
        """The least depth that `near_of` gives for any camera, in metres."""
        return min((self.near_m, *self.camera_near_m))

    def object_path(self, segment: int, part: Part) -> str:
        """Where the object of (segment, part) is fetched, relative to the manifest."""
        path = self.object_url.replace("{segment}", str(segment))
        return path.replace("{layer}", str(part))

    def segment_of(self, birth: int) -> int:
        """The segment that holds the slice born at `birth`."""
        return max(birth, 0) // self.segment_frames

    def births(self, segment: int, num_frames: int) -> range:
        """The births that the objects of `segment` hold, which shows `num_frames` frames. The
        slices before frame 0 are in its keyframes."""
        first = segment * self.segment_frames
        return range(first, first + num_frames)

    def part_births(self, segment: int, num_frames: int, part: Part) -> range:
        """The births that the object of `part` may have packets of, see `births`."""
        births = self.births(segment, num_frames)
        return births[:1] if is_keyframe(part) else births

    def is_same_but_live(self, other: Manifest) -> bool:
        """Whether both are of one stream, which may have ended in between."""
        return self.with_live(False).to_json() == other.with_live(False).to_json()

    def with_live(self, live: bool) -> Manifest:
        return replace(self, live=live)

    def to_json(self) -> bytes:
        """manifest.json, UTF-8, one key a line. Raises InvalidError if no reader would take it."""
        value = {
            "version": VERSION,
            "fps": self.fps,
            "swin_size": self.swin_size,
            "num_gs": self.num_gs,
            "slots": list(self.slots),
            "lattice": [lattice_to_json(lattice) for lattice in self.lattice],
            "segment_frames": self.segment_frames,
            "sh_degree": self.sh_degree,
            "antialias": self.antialias,
            "near_m": self.near_m,
            **({"camera_near_m": list(self.camera_near_m)} if self.camera_near_m else {}),
            "bounds": [list(corner) for corner in self.bounds],
            "cameras": [camera.to_json() for camera in self.cameras],
            "default_camera": self.default_camera,
            **({} if self.view is None else {"view": self.view.to_json()}),
            **({} if self.focus is None else {"focus": list(self.focus)}),
            "live": self.live,
            "poster": self.poster,
            **({} if self.storyboard is None else {"storyboard": self.storyboard}),
            "object_url": self.object_url,
            "title": self.title,
            "capture_frame": self.capture_frame,
            **({"sound": [source.to_json() for source in self.sound]} if self.sound else {}),
            **({"captions": [each.to_json() for each in self.captions]} if self.captions else {}),
        }
        text = json.dumps(value, ensure_ascii=False, allow_nan=False, indent=1) + "\n"
        data = text.encode()
        # When a stream is finished, `false` takes a byte more than `true`.
        if len(data) + self.live > MAX_MANIFEST_BYTES:
            raise InvalidError(
                f"manifest: {len(data)} bytes, at most {MAX_MANIFEST_BYTES}; shorten the names"
            )
        return data

    @staticmethod
    def from_json(data: bytes) -> Manifest:
        """The manifest in `data`. Raises CorruptError, or UnsupportedError for another version."""
        if len(data) > MAX_MANIFEST_BYTES:
            raise CorruptError(f"manifest: {len(data)} bytes, at most {MAX_MANIFEST_BYTES}")
        value = parse_manifest(data)
        version = value.get("version")
        if type(version) is not int:
            raise CorruptError("manifest: has no version; this is not a swings stream")
        if version != VERSION:
            raise UnsupportedError(
                f"manifest: version {version}, and this program reads {VERSION}; make the stream "
                "anew, or read it with the swings that made it"
            )
        try:
            with np.errstate(all="ignore"):
                return _from_value(value)
        except InvalidError as error:
            raise CorruptError(str(error)) from error


def _is_unicode(text: str) -> bool:
    """Whether `text` can be written as UTF-8: JSON can spell half of a surrogate pair."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def _camera_depths(value: Mapping[str, Any]) -> tuple[float, ...]:
    """The numbers of the key `camera_near_m`, which may be missing."""
    numbers = typed({"camera_near_m": [], **value}, "camera_near_m", list)
    if len(numbers) > MAX_CAMERAS or any(type(near_m) not in (int, float) for near_m in numbers):
        raise CorruptError(f"manifest: camera_near_m is not at most {MAX_CAMERAS} numbers")
    return tuple(number(near_m, "camera_near_m") for near_m in numbers)


def _view(value: Mapping[str, Any]) -> Camera | None:
    """The camera of the key `view`, which may be missing."""
    if "view" not in value:
        return None
    return Camera.from_json(typed(value, "view", dict))


def _point(value: object, what: str) -> Point:
    if type(value) is not list or len(value) != 3:
        raise CorruptError(f"manifest: {what} is not three numbers")
    x, y, z = (number(x, what) for x in value)
    return x, y, z


def _from_value(value: Mapping[str, Any]) -> Manifest:
    slots, lattices = typed(value, "slots", list), typed(value, "lattice", list)
    if any(type(count) is not int for count in slots):
        raise CorruptError("manifest: slots holds something that is not an integer")
    if len(slots) != len(lattices):
        raise CorruptError(f"manifest: {len(lattices)} lattices for {len(slots)} layers")
    corners = [_point(corner, "a corner of bounds") for corner in typed(value, "bounds", list)]
    if len(corners) != 2:
        raise CorruptError("manifest: bounds are not two corners")
    cameras = typed(value, "cameras", list)
    if len(cameras) > MAX_CAMERAS or any(type(camera) is not dict for camera in cameras):
        raise CorruptError(f"manifest: cameras are not at most {MAX_CAMERAS} objects")
    manifest = Manifest(
        fps=number(typed(value, "fps", int, float), "fps"),
        swin_size=typed(value, "swin_size", int),
        slots=tuple(slots),
        lattice=tuple(map(lattice_of, lattices[:MAX_LAYERS])),
        segment_frames=typed(value, "segment_frames", int),
        sh_degree=typed(value, "sh_degree", int),
        antialias=typed(value, "antialias", bool),
        near_m=number(typed(value, "near_m", int, float), "near_m"),
        bounds=(corners[0], corners[1]),
        cameras=tuple(Camera.from_json(camera) for camera in cameras),
        default_camera=typed(value, "default_camera", str),
        live=typed(value, "live", bool),
        poster=typed(value, "poster", str, type(None)),
        storyboard=typed({"storyboard": None, **value}, "storyboard", str, type(None)),
        object_url=typed(value, "object_url", str),
        title=typed(value, "title", str),
        capture_frame=typed(value, "capture_frame", int),
        sound=sources_of(value),
        camera_near_m=_camera_depths(value),
        captions=captions_of(value),
        view=_view(value),
        focus=None if "focus" not in value else _point(value["focus"], "focus"),
    )
    num_gs = typed(value, "num_gs", int)
    if num_gs != manifest.num_gs:
        raise CorruptError(
            f"manifest: num_gs {num_gs} is not swin_size {manifest.swin_size} times "
            f"{manifest.slice_size} slots"
        )
    return manifest
