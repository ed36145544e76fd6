"""Scores of a stream from some cameras, frame by frame."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from codec.arrays import Doubles, Floats
from codec.splats import Splats
from trainer.capture.capture import Mask
from trainer.step.loss import psnr_db

from .colourfit import colour_fitted
from .moving import Movement, movement_of
from .picture import captured, displayed, score_picture
from .truth import ScoredCameras

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
        """In the cameras' colours, see colourfit.py."""
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
