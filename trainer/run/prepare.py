"""Prepares a training run: checks the capture and the settings, seeds the first Gaussians, makes
the manifest. Nothing is written here.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from codec.errors import InvalidError
from codec.framerange import FrameRange
from codec.interop.formats import read_splats
from codec.lattice.forms import layer_coarseness
from codec.lattice.lattice import Lattice
from codec.rig import central_camera
from codec.sequence.survey import FPS_NAME
from codec.splats import Splats
from codec.stream.manifest import Manifest
from codec.stream.poster import POSTER_NAME, STORYBOARD_NAME
from codec.stream.wholeslice import RANKS, split_layers
from trainer.calibrate.lateness import late_doubts
from trainer.capture.capture import Capture, check_trainable
from trainer.capture.layout import open_capture
from trainer.capture.points import points_evenness, read_points_file
from trainer.errors import CaptureError
from trainer.fit.trainer import FALLBACK_FAR_M
from trainer.pictures.framecache import FrameCache, Pictures
from trainer.rig.doubts import coverage_doubts, rig_doubts, unseen_shares
from trainer.rig.nearplane import FALLBACK_NEAR_M, Seen, look, near_doubts, near_plane, near_planes
from trainer.seed.gaussians import initial_splats, stereo_seeds
from trainer.step.backend import MemoryNeeds
from trainer.step.device.pick import Picked

from .config import TrainConfig
from .outputs import writer_rank

GROWN = 1.25
"""Expected size of trained Gaussians, over the size of the first ones."""

LEAST_POINT_SHARE = 0.3
"""Least share of the first Gaussians that is placed at points, however few spots the points cover:
those spots matter most."""


@dataclass(frozen=True, slots=True)
class Prepared:
    """A capture and everything else that its training needs."""

    capture: Capture
    frames: range
    """Frames of the capture."""
    near_m: float
    far_m: float
    """Depths between which the scene lies."""
    search_from_m: float
    """Least depth at which places for Gaussians are looked for. The tried depths are few, and what
    one camera sees nearer than the rig suggests others see from farther away."""
    picked: Picked
    """Where the steps are computed."""
    initial: Splats | None = None
    """Gaussians with which the first frame begins, if they are given."""
    scale: float = 1.0
    """Size of the training pictures over the capture's."""
    memory: str | None = None
    """The plan of the backend's memory, one line."""
    near_doubts: tuple[str, ...] = ()
    """Doubts about near planes that were not given, a line each."""
    camera_near_m: tuple[float, ...] = ()
    """Nearest depth drawn in the view of each of the capture's cameras; empty where it is `near_m`
    for all."""

    @property
    def near_planes(self) -> tuple[float, ...]:
        """Nearest depth drawn in the view of each of the capture's cameras."""
        return self.camera_near_m or (self.near_m,) * len(self.capture.cameras)

    @property
    def training_planes(self) -> list[float]:
        """Nearest depth drawn in the view of each training camera."""
        return [self.near_planes[i] for i in self.capture.training]

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of the largest training pictures."""
        cameras = [self.capture.cameras[i].camera.scaled(self.scale) for i in self.capture.training]
        largest = max(cameras, key=lambda camera: camera.width_px * camera.height_px)
        return largest.width_px, largest.height_px

    def find_doubts(self) -> list[str]:
        """Reasons why the stream, or its scores, may be worse than the user expects, a line each.
        Reads pictures; raises CaptureError for one that cannot be read."""
        unseen = coverage_doubts(unseen_shares(self.capture))
        late = late_doubts(self.capture, self.frames)
        return [*rig_doubts(self.capture), *unseen, *self.near_doubts, *late]


def prepare(config: TrainConfig) -> Prepared:
    """Opens the capture. Raises SwingsError where capture or settings cannot work."""
    capture = open_capture(config.capture, config.choice)
    if config.points is not None and not config.resume:
        capture = replace(capture, points=read_points_file(config.points))
    check_trainable(capture)
    frames = FrameRange.parse(config.frames).of(capture.num_frames, capture.root)
    initial = None
    if not config.resume:  # the stream has both
        fps_of(capture, config)
        first_camera(config, capture)
        initial = _given_gaussians(config)
    picked = config.fit.backend(config.backend, config.torch_device)
    scale = training_scale(config, capture)
    memory = picked.backend.plan(memory_needs(config, capture, scale))
    # What cameras see takes time, and is not needed where the user knows the depth or was warned.
    seen = look(capture, frames) if config.near_m is None else None
    near_m, far_m = _depths(capture, config, seen)
    search_from_m = near_m
    if config.near_m is None and capture.near_m is not None:
        search_from_m = capture.near_m
    planes = () if config.near_m is not None else near_planes(capture, seen)
    near_lines = tuple(near_doubts(capture, seen, planes or near_m))
    return Prepared(
        capture, frames, near_m, far_m, search_from_m, picked, initial, scale, memory, near_lines,
        () if set(planes) == {near_m} else planes,
    )  # fmt: skip


def training_scale(config: TrainConfig, capture: Capture) -> float:
    """Size of the training pictures over the capture's."""
    if config.longest_px is None:
        return config.scale
    longest_px = max(max(c.camera.width_px, c.camera.height_px) for c in capture.cameras)
    return min(config.scale, config.longest_px / longest_px)


def memory_needs(config: TrainConfig, capture: Capture, scale: float) -> MemoryNeeds:
    """The size of the training, for the memory of its device."""
    cameras = [capture.cameras[i] for i in capture.training]
    scaled = [c.camera.scaled(scale) for c in cameras]
    return MemoryNeeds(
        config.fit.num_gs,
        config.fit.sh_degree,
        max(c.width_px * c.height_px for c in scaled),
        len(cameras) * (config.fit.swin_size + 1),
        any(c.masks is not None for c in cameras),
    )


def _given_gaussians(config: TrainConfig) -> Splats | None:
    """Gaussians of the file that the first frame begins with, if there is one."""
    path, fit = config.initial, config.fit
    if path is None:
        if not fit.genesis_iterations:
            raise InvalidError("genesis_iterations 0 needs given Gaussians; see --initial")
        return None
    splats = read_splats(path)
    if len(splats) != fit.num_gs:
        raise InvalidError(f"{path}: {len(splats)} Gaussians; set --num-gs {len(splats)}")
    return splats.with_degree(fit.sh_degree)


def fps_of(capture: Capture, config: TrainConfig) -> float:
    """Frames per second: as configured, else that of the capture. Raises CaptureError where
    neither gives one."""
    fps = capture.fps if config.fps is None else config.fps
    if fps is None:
        raise CaptureError(
            f"{capture.root}: no file gives the frame rate; give --fps, or write it to "
            f"{FPS_NAME} there"
        )
    return fps


def _depths(capture: Capture, config: TrainConfig, seen: Seen | None) -> tuple[float, float]:
    """Near and far depth, metres: as configured, else by what the cameras see, else the
    fallbacks."""
    near_m = config.near_m
    if near_m is None:
        near_m = near_plane(capture, seen)
    if near_m is None:
        near_m = FALLBACK_NEAR_M
    far_m = config.far_m
    if far_m is None:
        far_m = max(FALLBACK_FAR_M, 10 * near_m) if capture.far_m is None else capture.far_m
    if not 0 < near_m < far_m:
        raise InvalidError(f"near_m {near_m:g} and far_m {far_m:g}: choose 0 < near_m < far_m")
    return near_m, far_m


def shared_settings(config: TrainConfig, prepared: Prepared) -> dict[str, Any]:
    """Settings that a resumed run must share with the run that it continues."""
    return {
        **asdict(config.fit),
        "frames": [prepared.frames.start, prepared.frames.stop],
        "scale": prepared.scale,
        "near_m": prepared.near_m,
        **({"camera_near_m": list(prepared.camera_near_m)} if prepared.camera_near_m else {}),
        "far_m": prepared.far_m,
        "search_from_m": prepared.search_from_m,
        **({"without_cameras": config.without_cameras} if config.without_cameras else {}),
        **{
            name: getattr(config, name)
            for name in (
                "preset",
                "point_share",
                "layers",
                "rank",
                "whole_slices",
                "segment_frames",
            )
        },
        "raw_stream": config.raw_stream is not None,
        "backend": type(prepared.picked.backend).__name__,
        "first_picture": _fingerprint(prepared.capture, prepared.frames.start),
    }


def _fingerprint(capture: Capture, frame: int) -> str:
    """Hash of one picture: distinguishes the takes of one rig."""
    source = capture.open_images(capture.training[0])
    try:
        return hashlib.sha256(source.read(frame).tobytes()).hexdigest()
    finally:
        source.close()


def first_gaussians(config: TrainConfig, prepared: Prepared, pictures: Pictures) -> Splats:
    """The num_gs Gaussians to begin with: those of `config.initial`, or some at the capture's
    points and the rest where the cameras agree."""
    if prepared.initial is not None:
        return prepared.initial
    fit, points, cameras = config.fit, prepared.capture.points, pictures.cameras
    rng = np.random.default_rng(fit.seed)
    positions, colours = np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8)
    if points is not None:
        share = config.point_share
        if share is None:
            share = max(LEAST_POINT_SHARE, points_evenness(points, cameras))
        count = min(len(points), round(share * fit.num_gs))
        chosen = rng.choice(len(points), count, replace=False)
        positions, colours = points.xyz[chosen], points.rgb[chosen]
    missing = fit.num_gs - len(positions)
    if missing > 0:
        shots = [pictures.shot(c, 0) for c in range(len(cameras))]
        seeds, seed_colours = stereo_seeds(
            cameras, [s.picture for s in shots], missing, prepared.search_from_m, prepared.far_m,
            rng, [s.mask for s in shots],
        )  # fmt: skip
        if len(seeds) < missing:
            raise CaptureError(
                f"{prepared.capture.root}: no three training cameras see the same place from "
                f"{prepared.search_from_m:g} to {prepared.far_m:g} away; set --near-m and --far-m"
            )
        positions = np.concatenate([positions, seeds])
        colours = np.concatenate([colours, seed_colours])
    return initial_splats(positions, colours, fit.sh_degree)


def layer_slots(shares: Sequence[float], slice_size: int) -> tuple[int, ...]:
    """How many of the slots of a lane are in each layer."""
    edges = np.rint(np.cumsum((0.0, *shares)) * slice_size).astype(int)
    slots = tuple(int(count) for count in np.diff(edges))
    if min(slots) < 1:
        raise InvalidError(
            f"layers: {slice_size} Gaussians in a slice leave a layer without any; choose more "
            "Gaussians or fewer layers"
        )
    return slots


def first_camera(config: TrainConfig, capture: Capture) -> str:
    """The name of the camera that the stream opens with: as configured, else the most central one
    that is trained on. Raises InvalidError."""
    cameras = [c.camera for c in capture.cameras]
    names = [camera.name for camera in cameras]
    if config.default_camera is None:
        trained = [cameras[i] for i in capture.training]
        return trained[central_camera(trained)].name
    if config.default_camera not in names:
        raise InvalidError(
            f"--default-camera {config.default_camera[:80]}: {capture.root} has no such camera; it "
            f"has {', '.join(names[:20])}{', ...' if len(names) > 20 else ''}"
        )
    return config.default_camera


def make_manifest(
    config: TrainConfig, prepared: Prepared, cache: FrameCache, gaussians: Splats
) -> Manifest:
    """The manifest of a stream. gaussians: the first ones; where slices are sent whole, those of
    the first slice, whose ranges are those of trained Gaussians."""
    capture = prepared.capture
    cameras = tuple(cache.camera(i) for i in range(len(capture.cameras)))
    points = capture.points.xyz if capture.points is not None else gaussians.means
    low, high = np.percentile(points, 5, axis=0), np.percentile(points, 95, axis=0)
    slots = layer_slots(config.layers, config.fit.num_gs // config.fit.swin_size)
    is_trained = config.whole_slices or prepared.initial is not None
    lattice = Lattice.suiting(gaussians, 1 if is_trained else GROWN)
    coarseness = [1.0] * len(slots)
    if config.whole_slices:
        rows = split_layers(gaussians, slots, RANKS[writer_rank(config.rank)])
        coarseness = layer_coarseness([gaussians.take(part) for part in rows])
    return Manifest(
        fps=fps_of(capture, config),
        swin_size=config.fit.swin_size,
        slots=slots,
        lattice=tuple(map(lattice.coarser, coarseness)),
        segment_frames=config.segment_frames,
        sh_degree=config.fit.sh_degree,
        antialias=False,
        near_m=prepared.near_m,
        camera_near_m=prepared.camera_near_m,
        bounds=(
            (float(low[0]), float(low[1]), float(low[2])),
            (float(high[0]), float(high[1]), float(high[2])),
        ),
        cameras=cameras,
        default_camera=first_camera(config, capture),
        live=True,
        poster=POSTER_NAME,
        storyboard=STORYBOARD_NAME,
        title=config.title or capture.root.resolve().name,
        capture_frame=prepared.frames.start,
    )
