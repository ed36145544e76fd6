"""What a stream is worth: its decoded files, rendered for the held-out cameras, against the
capture."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import tyro
from rich.console import Group
from rich.markup import escape
from rich.table import Table

from codec.errors import InvalidError
from codec.storage.openstorage import Target
from codec.storage.targetargument import target_named
from codec.stream.reader import DEFAULT_MAX_GAUSSIANS
from player.show.sink import check_output
from trainer.capture.capture import Mask
from trainer.step.loss import psnr_db

from .colourfit import colour_fitted
from .moving import Movement, movement_of
from .picture import Floats, Score, captured, displayed, score_picture
from .traffic import Traffic, traffic
from .truth import HeldOut, open_held_out

STILL = 4 / 255
"""Largest change of a capture's pixel, in any channel, that counts as standing still."""

COLUMNS = (
    "layers", "PSNR\ndB", "moving\ndB", "SSIM", "flicker", "kB a\nframe", "Mbit/s",
    "bytes a\nGaussian",
)  # fmt: skip


@dataclass(frozen=True)
class EvaluateConfig:
    """Scores a stream's decoded files on the held-out cameras of its capture."""

    stream: tyro.conf.Positional[Annotated[Target, target_named("STREAM")]]
    """Folder of the stream, or its URL in an object store, such as s3://BUCKET/PATH."""
    capture: tyro.conf.Positional[Annotated[Target, target_named("CAPTURE")]]
    """Folder or URL of the capture that the stream was trained from."""
    json: bool = False
    """Print JSON instead of a table."""
    sheet: Path | None = None
    """Also draw a contact sheet (capture | rendered | error) to this PNG."""
    every: int = 1
    """Step between scored frames; flicker needs 1, every frame."""
    ablate_quantisation: bool = False
    """Score a raw stream instead, with one attribute at a time quantised as in the paper's Table
    6."""
    compare: Annotated[tuple[str, Path] | None, tyro.conf.arg(metavar="CAMERA OUT")] = None
    """Draw a comparison instead of scoring: for each frame the camera's picture, the rendered
    picture and the error, to an .mp4 or a folder of PNGs."""
    max_gaussians: int = DEFAULT_MAX_GAUSSIANS
    """Largest number of Gaussians a frame; a stream with more is refused, because a few kilobytes
    of file can ask for gigabytes of memory."""

    def __post_init__(self) -> None:
        """Raises InvalidError for options that do not go together."""
        if self.compare is None:
            return
        if self.json or self.sheet is not None or self.ablate_quantisation:
            raise InvalidError(
                "--compare draws and does not score; leave out --json, --sheet and "
                "--ablate-quantisation"
            )
        check_output(self.compare[1])


@dataclass(frozen=True, slots=True)
class LayerScore:
    """The stream at one number of layers; means over held-out cameras and frames, of the pixels
    that count."""

    layers: int
    psnr_db: float
    fitted_psnr_db: float
    """With each picture's colours fitted to its camera's: see colourfit.py."""
    ssim: float
    flicker: float | None
    """100 times the mean change between frames of pixels that the capture keeps still."""
    bytes_per_frame: float
    """Everything that one fetches who plays these layers from frame 0, over the frames: manifest,
    index and objects. Of version 2 these are masks, changes, and the snapshots of frame 0."""
    snapshot_bytes_per_frame: float
    """Snapshots of these layers at later frames, over the frames: stored for who joins there, and
    not fetched by who plays from frame 0. None in version 1, so 0."""
    bits_per_second: float
    """Of `bytes_per_frame`."""
    bytes_per_gaussian: float
    """Bytes of the objects in `bytes_per_frame` over the Gaussians that they bring. In version 2
    those are the Gaussians of frame 0 and then the active ones of every slice: what is kept costs
    a little of the mask, and is not counted."""
    per_frame_psnr_db: list[float]
    """Mean over the cameras."""
    per_camera_psnr_db: dict[str, float]
    per_camera_fitted_psnr_db: dict[str, float]
    moving_psnr_db: float | None
    """Over the pixels that move since the frame before, in the pictures where enough do."""
    per_frame_moving_psnr_db: list[float | None]
    """Mean over the cameras where enough pixels move."""


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
    moving_share: float | None
    """Of all pixels that count; None where no frame has one before it."""

    def to_json(self) -> dict[str, Any]:
        return asdict(self)

    def table(self) -> Group:
        """For people, in 80 columns: a row for each number of layers, then, with all layers, one
        for each camera."""
        return Group(self._layer_table(), self._camera_table())

    def _layer_table(self) -> Table:
        share = "" if self.moving_share is None else f", {self.moving_share:.1%} of pixels move"
        table = Table(title=f"{escape(self.stream)}: {self.frames} frames, {self.profile}{share}")
        for name in COLUMNS:
            table.add_column(name, justify="right", no_wrap=True)
        for row in self.layers:
            table.add_row(
                str(row.layers),
                f"{row.psnr_db:.2f}",
                "-" if row.moving_psnr_db is None else f"{row.moving_psnr_db:.2f}",
                f"{row.ssim:.4f}",
                "-" if row.flicker is None else f"{row.flicker:.3f}",
                f"{row.bytes_per_frame / 1e3:.1f}",
                f"{row.bits_per_second / 1e6:.2f}",
                f"{row.bytes_per_gaussian:.2f}",
            )
        return table

    def _camera_table(self) -> Table:
        table = Table()
        table.add_column("held-out camera", overflow="fold")
        for name in ("PSNR\ndB", "in its own\ncolours, dB"):
            table.add_column(name, justify="right", no_wrap=True)
        best = self.layers[-1]
        for camera, camera_psnr_db in best.per_camera_psnr_db.items():
            fitted_psnr_db = best.per_camera_fitted_psnr_db[camera]
            table.add_row(escape(camera), f"{camera_psnr_db:.2f}", f"{fitted_psnr_db:.2f}")
        table.add_section()
        table.add_row("mean", f"{best.psnr_db:.2f}", f"{best.fitted_psnr_db:.2f}")
        return table


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


def _by_name(names: list[str], scores: npt.NDArray[np.float64]) -> dict[str, float]:
    """Of each camera the mean; scores: (frames, cameras)."""
    return dict(zip(names, map(float, scores.mean(axis=0)), strict=True))


def _mean(values: Iterable[float | None]) -> float | None:
    """Of those that are there; None without any."""
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


class _Scores:
    """The scores of one number of layers, frame by frame, and its flicker."""

    def __init__(self) -> None:
        self.frames: list[list[Score]] = []
        """For each frame, a score for each camera."""
        self.fitted_psnr_db: list[list[float]] = []
        """The same in the cameras' colours."""
        self.moving: list[list[float | None]] = []
        """The same on the pixels that move."""
        self.flicker = _Flicker()

    def layer_score(
        self, layers: int, held_out: HeldOut, every: int, fetched: Traffic
    ) -> LayerScore:
        reader = held_out.reader
        psnr_db = np.array([[score.psnr_db for score in frame] for frame in self.frames])
        fitted_psnr_db = np.array(self.fitted_psnr_db)
        names = [camera.name for camera in held_out.cameras]
        num_bytes = (fetched.object_bytes + reader.overhead_bytes) / reader.num_frames
        return LayerScore(
            layers=layers,
            psnr_db=float(psnr_db.mean()),
            fitted_psnr_db=float(fitted_psnr_db.mean()),
            ssim=float(np.mean([score.ssim for frame in self.frames for score in frame])),
            flicker=self.flicker.value if every == 1 else None,
            bytes_per_frame=num_bytes,
            snapshot_bytes_per_frame=fetched.join_bytes / reader.num_frames,
            bits_per_second=8 * num_bytes * reader.manifest.fps,
            bytes_per_gaussian=fetched.object_bytes / max(fetched.gaussians, 1),
            per_frame_psnr_db=[float(x) for x in psnr_db.mean(axis=1)],
            per_camera_psnr_db=_by_name(names, psnr_db),
            per_camera_fitted_psnr_db=_by_name(names, fitted_psnr_db),
            moving_psnr_db=_mean(x for frame in self.moving for x in frame),
            per_frame_moving_psnr_db=[_mean(frame) for frame in self.moving],
        )


def _movements(held_out: HeldOut, frame: int) -> list[Movement]:
    """What moved in each held-out camera since the frame before; nothing in frame 0."""
    if frame == 0:
        return []
    cameras = range(len(held_out.cameras))
    return [movement_of(held_out.shot(c, frame - 1), held_out.shot(c, frame)) for c in cameras]


def evaluate_stream(
    config: EvaluateConfig, on_progress: Callable[[int, int], None] = lambda done, total: None
) -> Evaluation:
    """Renders every frame at every number of layers. on_progress(pictures done, in all).

    Raises what `open_held_out` and the methods of HeldOut raise.
    """
    with open_held_out(config.stream, config.capture, config.max_gaussians) as held_out:
        reader, manifest, cameras = held_out.reader, held_out.reader.manifest, held_out.cameras
        found = {layers: _Scores() for layers in range(1, manifest.num_layers + 1)}
        chosen = held_out.every(config.every)
        fetched = traffic(reader)
        done, total = 0, len(chosen) * len(found) * len(cameras)
        moving = counting = 0
        for frame in chosen:
            shots = held_out.shots(frame)
            movements = _movements(held_out, frame)
            moving += sum(movement.moving for movement in movements)
            counting += sum(movement.counting for movement in movements)
            truths = [captured(shot.picture) for shot in shots]
            for layers, scores in found.items():
                splats = reader.active_splats(frame, layers)
                scores.frames.append([])
                scores.fitted_psnr_db.append([])
                scores.moving.append([])
                for c, camera in enumerate(cameras):
                    shown, mask = displayed(splats, camera, manifest.near_m), shots[c].mask
                    scores.frames[-1].append(score_picture(shown, truths[c], mask))
                    fitted = colour_fitted(shown, truths[c], mask)
                    scores.fitted_psnr_db[-1].append(psnr_db(fitted, truths[c], mask))
                    scores.flicker.add(c, shown, truths[c], mask)
                    if movements:
                        scores.moving[-1].append(movements[c].psnr_db(shown, truths[c]))
                    done += 1
                    on_progress(done, total)
    return Evaluation(
        stream=str(config.stream),
        capture=str(config.capture),
        profile=manifest.profile.value,
        frames=reader.num_frames,
        fps=manifest.fps,
        cameras=[camera.name for camera in cameras],
        num_gs=manifest.num_gs,
        swin_size=manifest.swin_size,
        layers=[
            scores.layer_score(layers, held_out, config.every, fetched[layers - 1])
            for layers, scores in found.items()
        ],
        moving_share=moving / counting if counting else None,
    )
