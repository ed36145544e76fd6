"""Scores of a stream from some cameras, frame by frame, for each number of layers; and the bytes
that a player fetches for them.

The cameras of a rig differ in exposure and white balance, and those of a camera that training never
saw are not known. So a picture is also scored with a gain and a bias for each channel, fitted to
what the camera saw. What explains single cameras and not the scene shows as a gap between the
training cameras and those held out; more iterations widen it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from rich.table import Table

from codec.arrays import Doubles, Floats
from codec.splats import Splats
from codec.stream import StreamReader
from codec.tools.audit import count_slots
from trainer.capture.capture import Mask
from trainer.step.loss import psnr_db

from .truth import Movement, ScoredCameras, captured, displayed, movement_of, score_picture

LEAST_VARIANCE = 1e-8
"""Smallest variance of a channel that has a gain; with less, only a bias can be fitted."""


def colour_fitted(shown: Floats, truth: Floats, mask: Mask | None = None) -> Floats:
    """`shown`, (H, W, 3) in 0..1, with each channel's gain and bias of least squares to `truth`
    over the pixels that count; not clipped. Unchanged where none counts."""
    counts = np.ones(shown.shape[:2], bool) if mask is None else mask > 0
    if not counts.any():
        return shown
    seen, wanted = shown[counts].astype(np.float64), truth[counts].astype(np.float64)
    seen_mean, wanted_mean = seen.mean(axis=0), wanted.mean(axis=0)
    variance = ((seen - seen_mean) ** 2).mean(axis=0)
    covariance = ((seen - seen_mean) * (wanted - wanted_mean)).mean(axis=0)
    gain = np.where(variance > LEAST_VARIANCE, covariance / np.maximum(variance, LEAST_VARIANCE), 1)
    fitted: Floats = (gain * (shown - seen_mean) + wanted_mean).astype(np.float32)
    return fitted


STILL = 4 / 255
"""Largest change of a capture's pixel, in any channel, that counts as standing still."""


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """The pictures of some cameras of one frame."""

    truths: list[Floats]
    masks: list[Mask | None]
    movements: list[Movement]
    """The movement in each camera since the frame before; empty in frame 0."""


def seen_of(scored: ScoredCameras, frame: int) -> Seen:
    """A stream's `frame` as `scored`'s cameras saw it. Raises CaptureError where no pixel of one
    counts."""
    shots = scored.shots(frame)
    before = [] if frame == 0 else [scored.shot(c, frame - 1) for c in range(len(shots))]
    return Seen(
        [captured(shot.picture) for shot in shots],
        [shot.mask for shot in shots],
        [movement_of(*pair) for pair in zip(before, shots, strict=False)],
    )


class Flicker:
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


class Scores:
    """The scores of one number of layers from some cameras, and its flicker.

    Each list holds the frames, and for each frame a value for each camera.
    """

    def __init__(self) -> None:
        self.psnr_db: list[list[float]] = []
        self.fitted_psnr_db: list[list[float]] = []
        """In the cameras' colours, see `colour_fitted`."""
        self.ssim: list[list[float]] = []
        self.moving_psnr_db: list[list[float | None]] = []
        """Over the pixels that move; None where too few do."""
        self.fitted_moving_psnr_db: list[list[float | None]] = []
        """The same, with the colours fitted over the whole picture."""
        self.flicker = Flicker()

    def add(self, splats: Splats, scored: ScoredCameras, seen: Seen) -> None:
        """Renders one frame, `splats`, from all cameras."""
        rows = (self.psnr_db, self.fitted_psnr_db, self.ssim)
        moving_rows = (self.moving_psnr_db, self.fitted_moving_psnr_db)
        for row in (*rows, *moving_rows):
            row.append([])
        for c, camera in enumerate(scored.cameras):
            truth, mask = seen.truths[c], seen.masks[c]
            shown = displayed(splats, camera, scored.reader.manifest.near_of(camera))
            fitted = colour_fitted(shown, truth, mask)
            score = score_picture(shown, truth, mask)
            values = (score.psnr_db, psnr_db(fitted, truth, mask), score.ssim)
            for row, value in zip(rows, values, strict=True):
                row[-1].append(value)
            if seen.movements:
                for moving_row, picture in zip(moving_rows, (shown, fitted), strict=True):
                    moving_row[-1].append(seen.movements[c].psnr_db(picture, truth))
            self.flicker.add(c, shown, truth, mask)


def mean(values: Iterable[float | None]) -> float | None:
    """The mean of those that are not None; None without any."""
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def frame_means(frames: Sequence[Sequence[float | None]]) -> list[float | None]:
    """The mean of each frame over its cameras."""
    return [mean(frame) for frame in frames]


def camera_means(names: Sequence[str], frames: Sequence[Sequence[float]]) -> dict[str, float]:
    """The mean of each camera over the frames."""
    scores: Doubles = np.array(frames)
    return dict(zip(names, map(float, scores.mean(axis=0)), strict=True))


@dataclass(frozen=True, slots=True)
class SideScore:
    """All layers of a stream, seen from its training cameras or from the held-out ones: PSNR in dB,
    means over cameras and frames, and for each frame over the cameras. None where nothing moves."""

    psnr_db: float | None
    fitted_psnr_db: float | None
    """With each picture's colours fitted to its camera's: see `colour_fitted`."""
    moving_psnr_db: float | None
    """Over the pixels that move since the frame before."""
    fitted_moving_psnr_db: float | None
    per_frame_psnr_db: list[float | None]
    per_frame_fitted_psnr_db: list[float | None]
    per_frame_moving_psnr_db: list[float | None]
    per_frame_fitted_moving_psnr_db: list[float | None]

    @property
    def means(self) -> tuple[float | None, ...]:
        """The four means."""
        return self.psnr_db, self.fitted_psnr_db, self.moving_psnr_db, self.fitted_moving_psnr_db


@dataclass(frozen=True, slots=True)
class Gap:
    """Both sides."""

    training: SideScore
    held_out: SideScore

    def table(self) -> Table:
        """A row for each side, and their difference."""
        table = Table()
        table.add_column("cameras")
        for name in ("PSNR\ndB", "fitted\ndB", "moving\ndB", "moving,\nfitted, dB"):
            table.add_column(name, justify="right", no_wrap=True)
        sides = self.training.means, self.held_out.means
        rows = zip(("training", "held out"), sides, strict=True)
        for name, values in rows:
            table.add_row(name, *map(_text, values))
        table.add_section()
        pairs = zip(*sides, strict=True)
        gaps = (None if a is None or b is None else a - b for a, b in pairs)
        table.add_row("gap", *map(_text, gaps))
        return table


def side_score(scores: Scores) -> SideScore:
    """The means of `scores`."""
    whole, fitted = frame_means(scores.psnr_db), frame_means(scores.fitted_psnr_db)
    moving = frame_means(scores.moving_psnr_db)
    fitted_moving = frame_means(scores.fitted_moving_psnr_db)
    return SideScore(
        psnr_db=mean(whole),
        fitted_psnr_db=mean(fitted),
        # Over the pictures where enough moves, as everywhere; not every frame has as many of them.
        moving_psnr_db=mean(x for frame in scores.moving_psnr_db for x in frame),
        fitted_moving_psnr_db=mean(x for frame in scores.fitted_moving_psnr_db for x in frame),
        per_frame_psnr_db=whole,
        per_frame_fitted_psnr_db=fitted,
        per_frame_moving_psnr_db=moving,
        per_frame_fitted_moving_psnr_db=fitted_moving,
    )


def _text(value_db: float | None) -> str:
    return "-" if value_db is None else f"{value_db:.2f}"


@dataclass(frozen=True, slots=True)
class Traffic:
    """The traffic of a player of one number of layers."""

    object_bytes: int
    """Size of the objects that a player from frame 0 on fetches."""
    gaussians: int
    """Gaussians in those objects: those of frame 0, and all that a later slice sends,
    whether new or changed."""
    join_bytes: int
    """Size of the keyframes that a player fetches only if it joins later, or takes up a layer
    again."""


def traffic(reader: StreamReader) -> list[Traffic]:
    """The traffic of 1, 2, ... layers. Raises a CodecError that names the object at fault."""
    manifest, records = reader.manifest, reader.records
    layers = range(1, manifest.num_layers + 1)
    brought = np.cumsum(count_slots(reader).brought)
    found = []
    for n in layers:
        played = sum(sum(record.object_bytes[:n]) + record.side_bytes[0] for record in records)
        keyframes = [sum(record.side_bytes[1 : n + 1]) for record in records]
        found.append(Traffic(played + sum(keyframes[:1]), int(brought[n - 1]), sum(keyframes[1:])))
    return found
