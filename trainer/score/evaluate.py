"""What a stream is worth: its decoded files, rendered for the held-out cameras, against the
capture."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import tyro
from rich.table import Table

from codec.camera import Camera
from codec.errors import InvalidError
from codec.splats import Splats
from codec.stream import StreamReader
from codec.stream.manifest import Manifest
from player.render.cpu import render_splats
from trainer.capture.capture import Capture, Mask
from trainer.capture.layout import open_capture
from trainer.errors import CaptureError
from trainer.pictures.framecache import FrameCache
from trainer.step.loss import psnr_db, ssim

Floats = npt.NDArray[np.float32]

STILL = 4 / 255
"""Largest change of a capture's pixel, in any channel, that counts as standing still."""


@dataclass(frozen=True)
class EvaluateConfig:
    """Scores a stream's decoded files on the held-out cameras of its capture."""

    stream: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="STREAM")]
    """Folder of the stream."""
    capture: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="CAPTURE")]
    """Folder of the capture that it was trained from."""
    json: bool = False
    """Print JSON instead of a table."""
    sheet: Path | None = None
    """Also draw a contact sheet to this PNG: capture | rendered | error."""
    every: int = 1
    """Score every n-th frame; flicker needs 1."""
    ablate_quantisation: bool = False
    """Score instead a raw stream with one attribute at a time quantised as in the paper's
    Table 6."""


@dataclass(frozen=True, slots=True)
class Score:
    """One picture."""

    psnr_db: float
    ssim: float


@dataclass(frozen=True, slots=True)
class LayerScore:
    """The stream at one number of layers; means over held-out cameras and frames, of the pixels
    that count."""

    layers: int
    psnr_db: float
    ssim: float
    flicker: float | None
    """100 times the mean change between frames of pixels that the capture keeps still."""
    bytes_per_frame: float
    """Everything: objects of these layers, index and manifest, over the frames."""
    bits_per_second: float
    bytes_per_gaussian: float
    per_frame_psnr_db: list[float]
    """Mean over the cameras."""
    per_camera_psnr_db: dict[str, float]


@dataclass(frozen=True, slots=True)
class Evaluation:
    """All numbers of layers, fewest first."""

    stream: str
    capture: str
    profile: str
    frames: int
    fps: float
    cameras: list[str]
    num_gs: int
    swin_size: int
    layers: list[LayerScore]

    def to_json(self) -> dict[str, Any]:
        return asdict(self)

    def table(self) -> Table:
        """For people: a row for each number of layers."""
        table = Table(
            title=f"{self.stream}: {self.frames} frames, {self.profile}, "
            f"held out: {', '.join(self.cameras)}"
        )
        for name in ("layers", "PSNR dB", "SSIM", "flicker", "kB/frame", "Mbit/s", "B/Gaussian"):
            table.add_column(name, justify="right")
        for row in self.layers:
            table.add_row(
                str(row.layers),
                f"{row.psnr_db:.2f}",
                f"{row.ssim:.4f}",
                "-" if row.flicker is None else f"{row.flicker:.3f}",
                f"{row.bytes_per_frame / 1e3:.1f}",
                f"{row.bits_per_second / 1e6:.2f}",
                f"{row.bytes_per_gaussian:.2f}",
            )
        return table


def displayed(picture: Floats) -> Floats:
    """The picture as a screen shows it: in 0..1 and rounded to 8 bits."""
    shown: Floats = np.rint(np.clip(picture, 0, 1) * np.float32(255)) / np.float32(255)
    return shown


def score_picture(
    splats: Splats,
    camera: Camera,
    truth: npt.NDArray[np.uint8],
    near_m: float,
    mask: Mask | None = None,
) -> Score:
    """How `splats` look from `camera` against the (H, W, 3) uint8 `truth`, where the mask counts.
    NaN where nothing does."""
    shown = displayed(render_splats(splats, camera, near_m))
    goal = truth.astype(np.float32) / np.float32(255)
    return Score(psnr_db(shown, goal, mask), ssim(shown, goal, mask))


class _Flicker:
    """Sums the change of still pixels that count from frame to frame, camera by camera."""

    def __init__(self) -> None:
        self._before: dict[int, tuple[Floats, Floats, Mask | None]] = {}
        self._sum = 0.0
        self._count = 0

    def add(self, camera: int, shown: Floats, truth: Floats, mask: Mask | None) -> None:
        if camera in self._before:
            shown_before, truth_before, mask_before = self._before[camera]
            still = np.abs(truth - truth_before).max(axis=2) <= STILL
            for counts in (mask, mask_before):
                if counts is not None:
                    still &= counts > 0
            self._sum += float(np.abs(shown - shown_before)[still].sum())
            self._count += 3 * int(still.sum())
        self._before[camera] = (shown, truth, mask)

    @property
    def value(self) -> float | None:
        return 100 * self._sum / self._count if self._count else None


def stream_cameras(manifest: Manifest, capture: Capture, name: str) -> list[Camera]:
    """The capture's cameras at the sizes that the stream `name` was trained at.

    Raises CaptureError when a held-out camera is missing in the stream or is another one there.
    """
    known = {camera.name: camera for camera in manifest.cameras}
    for index in capture.held_out:
        camera = capture.cameras[index].camera
        if camera.name not in known:
            raise CaptureError(f"{name} does not know camera {camera.name}: another capture?")
        trained = known[camera.name]
        scale = trained.width_px / camera.width_px
        same_pose = np.allclose(trained.w2c, camera.w2c, atol=1e-4)
        if not same_pose or abs(trained.height_px - scale * camera.height_px) > 1:
            raise CaptureError(
                f"{name}: camera {camera.name} is not the one that the stream was trained with"
            )
    return [known.get(c.camera.name, c.camera) for c in capture.cameras]


@dataclass(frozen=True, slots=True)
class HeldOut:
    """A stream beside the pictures of its capture's held-out cameras."""

    reader: StreamReader
    cameras: list[Camera]  # at the stream's size
    indices: tuple[int, ...]  # of the cameras, in the capture
    cache: FrameCache

    def every(self, step: int) -> range:
        """The frames 0, step, 2 step, ... of the stream. Raises InvalidError below 1."""
        if step < 1:
            raise InvalidError(f"every {step}: choose 1 or more")
        return range(0, self.reader.num_frames, step)

    def pictures(self, frame: int) -> list[npt.NDArray[np.uint8]]:
        """The (H, W, 3) uint8 pictures that the cameras took of the stream's `frame`."""
        return [self.cache.image(i, self.cache.frames[frame]) for i in self.indices]

    def masks(self, frame: int) -> list[Mask | None]:
        """Where those pictures count; None where they do everywhere. Raises CaptureError if one
        counts nowhere."""
        masks = [self.cache.mask(i, self.cache.frames[frame]) for i in self.indices]
        for camera, mask in zip(self.cameras, masks, strict=True):
            if mask is not None and not mask.any():
                raise CaptureError(
                    f"{self.cache.capture.root}: the mask of camera {camera.name} ignores all of "
                    f"frame {self.cache.frames[frame]}; hold out a camera that sees something"
                )
        return masks


@contextmanager
def open_held_out(stream: Path, capture_path: Path) -> Iterator[HeldOut]:
    """Raises CaptureError where the capture is not the stream's or holds no camera out, and
    InvalidError for a stream without a frame."""
    reader = StreamReader(stream)
    manifest = reader.manifest
    capture = open_capture(capture_path)
    held_out = capture.held_out
    if not held_out:
        raise CaptureError(f"{capture.root}: no held-out camera to score with")
    if reader.num_frames == 0:
        raise InvalidError(f"{stream}: the stream has no finished segment yet")
    frames = range(manifest.capture_frame, manifest.capture_frame + reader.num_frames)
    if frames.stop > capture.num_frames:
        raise CaptureError(
            f"{capture.root} has {capture.num_frames} frames, the stream needs {frames.stop}"
        )
    cameras = stream_cameras(manifest, capture, str(stream))
    with FrameCache(capture, frames, cameras=cameras) as cache:
        yield HeldOut(reader, [cache.camera(i) for i in held_out], held_out, cache)


def evaluate_stream(
    config: EvaluateConfig, on_progress: Callable[[int, int], None] = lambda done, total: None
) -> Evaluation:
    """Renders every frame at every number of layers. on_progress(pictures done, in all)."""
    scores: dict[tuple[int, int, int], Score] = {}
    with open_held_out(config.stream, config.capture) as held_out:
        reader, manifest, cameras = held_out.reader, held_out.reader.manifest, held_out.cameras
        counts = range(1, manifest.num_layers + 1)
        chosen = held_out.every(config.every)
        flicker = {layers: _Flicker() for layers in counts}
        done, total = 0, len(chosen) * len(counts) * len(cameras)
        for frame in chosen:
            truths = [
                picture.astype(np.float32) / np.float32(255) for picture in held_out.pictures(frame)
            ]
            masks = held_out.masks(frame)
            for layers in counts:
                splats = reader.active_splats(frame, layers)
                for c, camera in enumerate(cameras):
                    shown = displayed(render_splats(splats, camera, manifest.near_m))
                    scores[frame, layers, c] = Score(
                        psnr_db(shown, truths[c], masks[c]), ssim(shown, truths[c], masks[c])
                    )
                    flicker[layers].add(c, shown, truths[c], masks[c])
                    done += 1
                    on_progress(done, total)
    result = []
    for layers in counts:
        grid = np.array(
            [[scores[f, layers, c].psnr_db for c in range(len(cameras))] for f in chosen]
        )
        object_bytes = sum(sum(r.object_bytes[:layers]) for r in reader.records)
        num_bytes = (object_bytes + reader.overhead_bytes) / reader.num_frames
        slices = reader.num_frames + manifest.swin_size - 1
        gaussians = slices * manifest.slice_size * sum(manifest.layers[:layers])
        result.append(
            LayerScore(
                layers=layers,
                psnr_db=float(grid.mean()),
                ssim=float(
                    np.mean(
                        [scores[f, layers, c].ssim for f in chosen for c in range(len(cameras))]
                    )
                ),
                flicker=flicker[layers].value if config.every == 1 else None,
                bytes_per_frame=num_bytes,
                bits_per_second=8 * num_bytes * manifest.fps,
                bytes_per_gaussian=object_bytes / gaussians,
                per_frame_psnr_db=[float(x) for x in grid.mean(axis=1)],
                per_camera_psnr_db={
                    camera.name: float(x)
                    for camera, x in zip(cameras, grid.mean(axis=0), strict=True)
                },
            )
        )
    return Evaluation(
        stream=str(config.stream),
        capture=str(config.capture),
        profile=manifest.profile.value,
        frames=reader.num_frames,
        fps=manifest.fps,
        cameras=[camera.name for camera in cameras],
        num_gs=manifest.num_gs,
        swin_size=manifest.swin_size,
        layers=result,
    )
