"""The quality of a stream: its decoded files, rendered for the held-out cameras, against the
capture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import fmean
from typing import Annotated, Any

import tyro
from rich.console import Group
from rich.markup import escape
from rich.table import Table

from codec.errors import InvalidError
from codec.storage.openstorage import Target, target_named
from codec.stream.reader import DEFAULT_MAX_GAUSSIANS
from player.show.sink import check_output
from trainer.rig.doubts import UNSEEN_SHARE, unseen_shares

from .scores import (
    Gap,
    Scores,
    Traffic,
    camera_means,
    frame_means,
    mean,
    seen_of,
    side_score,
    traffic,
)
from .truth import ScoredCameras, open_held_out

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
    training_cameras: bool = False
    """Also score all layers on the training cameras, and print the gap to the held-out ones: what
    explains single cameras rather than the scene."""
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
        if self.json or self.sheet or self.training_cameras:
            raise InvalidError(
                "--compare draws and does not score; leave out --json, --sheet and "
                "--training-cameras"
            )
        check_output(self.compare[1])


@dataclass(frozen=True, slots=True)
class LayerScore:
    """The stream at one number of layers; means over held-out cameras and frames, of the pixels
    that count."""

    layers: int
    psnr_db: float
    fitted_psnr_db: float
    """With each picture's colours fitted to its camera's: see scores.py."""
    ssim: float
    flicker: float | None
    """100 times the mean change between frames of pixels that the capture keeps still."""
    bytes_per_frame: float
    """Everything that a player of these layers from frame 0 on fetches, over the frames: manifest,
    index, skip maps, changes, and the keyframes of frame 0."""
    keyframe_bytes_per_frame: float
    """Keyframes of these layers at later frames, over the frames: stored for players that join
    there, and not fetched by one from frame 0 on."""
    bits_per_second: float
    """`bytes_per_frame` as a bitrate."""
    bytes_per_gaussian: float
    """Bytes of the objects in `bytes_per_frame` over the Gaussians that they bring: those of frame
    0, and the changed and new ones of every slice. What is kept costs a little of the skip map, and
    is not counted."""
    per_frame_psnr_db: list[float]
    """Mean over the cameras."""
    per_camera_psnr_db: dict[str, float]
    per_camera_fitted_psnr_db: dict[str, float]
    moving_psnr_db: float | None
    """Over the pixels that move since the frame before, in the pictures where enough do."""
    per_frame_moving_psnr_db: list[float | None]
    """Mean over the cameras where enough pixels move."""
    fitted_moving_psnr_db: float | None
    """`moving_psnr_db` with each picture's colours fitted, over the whole picture."""


@dataclass(frozen=True, slots=True)
class Evaluation:
    """All numbers of layers, fewest first."""

    stream: str
    capture: str
    frames: int
    fps: float
    cameras: list[str]
    num_gs: int
    swin_size: int
    layers: list[LayerScore]
    moving_share: float | None
    """Share of the pixels that move; None where no frame has one before it."""
    unseen_shares: dict[str, float]
    """Share of each held-out camera's picture that no training camera sees: what is drawn there is
    not trained, so the camera's score says little."""
    gap: Gap | None = None
    """All layers from the training cameras and the held-out ones, where it was asked for."""

    def to_json(self) -> dict[str, Any]:
        return asdict(self)

    def table(self) -> Group:
        """For people, in 80 columns: a row for each number of layers, then, with all layers, one
        for each camera."""
        tables = [self._layer_table(), self._camera_table()]
        return Group(*tables, *([] if self.gap is None else [self.gap.table()]))

    def _layer_table(self) -> Table:
        share = "" if self.moving_share is None else f", {self.moving_share:.1%} of pixels move"
        table = Table(title=f"{escape(self.stream)}: {self.frames} frames{share}")
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
        columns = ["PSNR\ndB", "in its own\ncolours, dB"]
        has_unseen = max(self.unseen_shares.values()) > UNSEEN_SHARE
        for name in columns + ["unseen by\ntraining"] * has_unseen:
            table.add_column(name, justify="right", no_wrap=True)
        best = self.layers[-1]
        for camera, camera_psnr_db in best.per_camera_psnr_db.items():
            fitted_psnr_db = best.per_camera_fitted_psnr_db[camera]
            row = [escape(camera), f"{camera_psnr_db:.2f}", f"{fitted_psnr_db:.2f}"]
            table.add_row(*row, *[f"{self.unseen_shares[camera]:.0%}"] * has_unseen)
        table.add_section()
        table.add_row("mean", f"{best.psnr_db:.2f}", f"{best.fitted_psnr_db:.2f}")
        return table


def evaluate_stream(
    config: EvaluateConfig, on_progress: Callable[[int, int], None] = lambda done, total: None
) -> Evaluation:
    """Renders every frame at every number of layers. on_progress(pictures done, in all).

    Raises what `open_held_out` and the methods of ScoredCameras raise.
    """
    with open_held_out(config.stream, config.capture, config.max_gaussians) as held_out:
        reader, manifest, cameras = held_out.reader, held_out.reader.manifest, held_out.cameras
        found = {layers: Scores() for layers in range(1, manifest.num_layers + 1)}
        chosen = held_out.every(config.every)
        training, trained = held_out.training if config.training_cameras else None, Scores()
        fetched = traffic(reader)
        pictures = len(found) * len(cameras) + (len(training.cameras) if training else 0)
        done = moving = counting = 0
        for frame in chosen:
            seen = seen_of(held_out, frame)
            moving += sum(movement.moving for movement in seen.movements)
            counting += sum(movement.counting for movement in seen.movements)
            for layers, scores in found.items():
                scores.add(reader.active_splats(frame, layers), held_out, seen)
                done += len(cameras)
                on_progress(done, pictures * len(chosen))
            if training is not None:
                splats = reader.active_splats(frame, manifest.num_layers)
                trained.add(splats, training, seen_of(training, frame))
                done += len(training.cameras)
                on_progress(done, pictures * len(chosen))
        best = found[manifest.num_layers]
        gap = Gap(side_score(trained), side_score(best)) if training is not None else None
    return Evaluation(
        stream=str(config.stream),
        capture=str(config.capture),
        frames=reader.num_frames,
        fps=manifest.fps,
        cameras=[camera.name for camera in cameras],
        num_gs=manifest.num_gs,
        swin_size=manifest.swin_size,
        layers=[
            _layer_score(layers, scores, held_out, config.every, fetched[layers - 1])
            for layers, scores in found.items()
        ],
        moving_share=moving / counting if counting else None,
        unseen_shares=unseen_shares(held_out.cache.capture),
        gap=gap,
    )


def _layer_score(
    layers: int, scores: Scores, held_out: ScoredCameras, every: int, fetched: Traffic
) -> LayerScore:
    reader = held_out.reader
    names = [camera.name for camera in held_out.cameras]
    num_bytes = (fetched.object_bytes + reader.overhead_bytes) / reader.num_frames
    return LayerScore(
        layers=layers,
        psnr_db=_overall(scores.psnr_db),
        fitted_psnr_db=_overall(scores.fitted_psnr_db),
        ssim=_overall(scores.ssim),
        flicker=scores.flicker.value if every == 1 else None,
        bytes_per_frame=num_bytes,
        keyframe_bytes_per_frame=fetched.join_bytes / reader.num_frames,
        bits_per_second=8 * num_bytes * reader.manifest.fps,
        bytes_per_gaussian=fetched.object_bytes / max(fetched.gaussians, 1),
        per_frame_psnr_db=[fmean(frame) for frame in scores.psnr_db],
        per_camera_psnr_db=camera_means(names, scores.psnr_db),
        per_camera_fitted_psnr_db=camera_means(names, scores.fitted_psnr_db),
        moving_psnr_db=mean(x for frame in scores.moving_psnr_db for x in frame),
        per_frame_moving_psnr_db=frame_means(scores.moving_psnr_db),
        fitted_moving_psnr_db=mean(x for frame in scores.fitted_moving_psnr_db for x in frame),
    )


def _overall(frames: Sequence[Sequence[float]]) -> float:
    """The mean over frames and cameras."""
    return fmean(value for frame in frames for value in frame)
