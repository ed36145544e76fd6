"""The quality of experience of a play, as one number and its parts.

    quality = mean PSNR - stall_db * waiting / length - switch_db * mean |step|

waiting: seconds before the first frame and of stalls; length: of what was shown, without waiting;
steps: of what the missing layers cost, between consecutive stretches of stretch_s. What the scene
itself changes is no switch: a play of all layers has no step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import fmean

from codec.errors import InvalidError


@dataclass(frozen=True, slots=True)
class QoeConfig:
    """Costs of waiting and of quality changes."""

    stall_db: float = 33.0
    """Cost of waiting for as long as the time shown, in dB: 1 % of waiting costs 0.33 dB."""
    switch_db: float = 1.0
    """Cost of a mean step of 1 dB from one stretch to the next, in dB."""
    stretch_s: float = 0.5
    """Length of a stretch: seconds over which losses are averaged before steps are computed."""

    def __post_init__(self) -> None:
        if not (self.stall_db >= 0 and self.switch_db >= 0 and self.stretch_s > 0):
            raise InvalidError(f"{self}: give costs of at least 0 and stretch_s over 0")


@dataclass(frozen=True, slots=True)
class Qoe:
    """One play, scored."""

    quality_db: float
    """The number."""
    psnr_db: float
    """Mean over the frames."""
    low_psnr_db: float
    """The 5th percentile of the frames."""
    startup_s: float
    stalled_s: float
    stalls: int
    step_db: float
    """Mean step between stretches, of the PSNR lost against all layers."""


def score(
    psnr_db: Sequence[float],
    best_db: Sequence[float],
    fps: float,
    startup_s: float,
    stalled_s: float,
    stalls: int,
    config: QoeConfig | None = None,
) -> Qoe:
    """Scores a play that showed frames of `psnr_db`, at least one, in their order. best_db: PSNR of
    the same frames with all layers."""
    config = config or QoeConfig()
    length = max(1, round(config.stretch_s * fps))
    count = max(1, len(psnr_db) // length)
    lost_db = [best - shown for shown, best in zip(psnr_db, best_db, strict=True)]
    # What is left over at the end belongs to no stretch.
    stretches = [fmean(lost_db[n * length : (n + 1) * length]) for n in range(count)]
    step_db = fmean(abs(b - a) for a, b in pairwise(stretches)) if count > 1 else 0.0
    mean_db = fmean(psnr_db)
    waiting = (startup_s + stalled_s) * fps / len(psnr_db)
    return Qoe(
        quality_db=mean_db - config.stall_db * waiting - config.switch_db * step_db,
        psnr_db=mean_db,
        low_psnr_db=sorted(psnr_db)[int(0.05 * len(psnr_db))],
        startup_s=startup_s,
        stalled_s=stalled_s,
        stalls=stalls,
        step_db=step_db,
    )
