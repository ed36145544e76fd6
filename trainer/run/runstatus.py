"""How far a training run is."""

from __future__ import annotations

from dataclasses import dataclass

from codec.progressline import Stage


@dataclass(frozen=True, slots=True)
class RunStatus:
    """A run at a moment."""

    frame: int
    """The frame that the running window begins with."""
    num_frames: int
    share: float
    """Finished share of all iterations, 0 to 1."""
    elapsed_s: float
    left_s: float | None
    """None until an iteration was timed."""
    psnr_db: float | None = None
    """Mean over the held-out cameras; None before the first frame is finished."""
    bytes_per_frame: float | None = None
    """Mean size of the frames in the stream; None before its first segment is on disk."""
    iterations_per_s: float | None = None

    def stage(self) -> Stage:
        """Text of the progress line."""
        frame, total = self.frame, self.num_frames
        figures = (
            (self.psnr_db, "{:.2f} dB", 1.0),
            (self.bytes_per_frame, "{:.1f} kB/frame", 1e3),
            (self.iterations_per_s, "{:.0f} it/s", 1.0),
        )
        return Stage(
            f"frame {frame} of {total}" if frame else f"first of {total} frames",
            self.share,
            self.elapsed_s,
            self.left_s,
            tuple(text.format(value / unit) for value, text, unit in figures if value is not None),
        )

    def log_row(self) -> dict[str, float | None]:
        """Entry of the log, once `frame` is finished."""
        left_s, psnr_db = self.left_s, self.psnr_db
        return {
            "frame": self.frame,
            "time_s": round(self.elapsed_s, 3),
            "left_s": None if left_s is None else round(left_s, 1),
            "psnr_db": None if psnr_db is None else round(psnr_db, 3),
            "bytes_per_frame": round(self.bytes_per_frame or 0),
        }
