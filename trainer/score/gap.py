"""How much better a stream looks from the cameras that trained it than from those held out.

What explains single cameras and not the scene shows as a gap between the two; more iterations widen
it.
"""

from __future__ import annotations

from dataclasses import dataclass

from rich.table import Table

from .scores import Scores, frame_means, mean


@dataclass(frozen=True, slots=True)
class SideScore:
    """All layers of a stream, seen from its training cameras or from the held-out ones: PSNR in dB,
    means over cameras and frames, and for each frame over the cameras. None where nothing moves."""

    psnr_db: float | None
    fitted_psnr_db: float | None
    """With each picture's colours fitted to its camera's: see colourfit.py."""
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
