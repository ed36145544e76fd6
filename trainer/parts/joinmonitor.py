"""What a person sees while parts are trained and joined, and what the log keeps of it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

from codec.stream.index import SegmentRecord
from trainer.run.progressline import ProgressLine, Standing
from trainer.run.runlog import RunLog


class JoinMonitor:
    """Tells a progress line of all iterations of all workers, and a log of every segment that has
    joined the stream."""

    def __init__(
        self,
        line: ProgressLine,
        log: RunLog,
        num_frames: int,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._line, self._log, self._num_frames, self._now_s = line, log, num_frames, now_s
        self._begin_s, self._total, self._done = now_s(), 1, 0
        self._frames = self._scored_frames = 0
        self._played_bytes = 0
        self._psnr_sum_db = 0.0

    def begin(self, iterations: int) -> None:
        """All workers together have so many before them."""
        self._begin_s, self._total = self._now_s(), max(iterations, 1)

    def found(self, records: Sequence[SegmentRecord]) -> None:
        """These have joined the stream before."""
        for record in records:
            self._count(record)

    def progressed(self, iterations: int) -> None:
        """All workers together have done so many since they began."""
        self._done = iterations
        self._line.tell(self._standing())

    def joined(self, records: Sequence[SegmentRecord]) -> None:
        """These have joined the stream now."""
        for record in records:
            self._count(record)
            standing = self._standing()
            left_s, psnr_db = standing.left_s, standing.psnr_db
            self._log.add(
                {
                    "frame": self._frames - 1,
                    "time_s": round(standing.gone_s, 3),
                    "left_s": None if left_s is None else round(left_s, 1),
                    "psnr_db": None if psnr_db is None else round(psnr_db, 3),
                    "bytes_per_frame": round(self._played_bytes / self._frames),
                }
            )
            self._line.tell(standing)

    def _count(self, record: SegmentRecord) -> None:
        self._frames = record.first_frame + record.num_frames
        self._played_bytes += record.played_bytes
        if not math.isnan(record.psnr_db[-1]):
            self._scored_frames += record.num_frames
            self._psnr_sum_db += record.num_frames * record.psnr_db[-1]

    def _standing(self) -> Standing:
        gone_s, frames = self._now_s() - self._begin_s, self._frames
        left_s = gone_s / self._done * (self._total - self._done) if self._done else None
        scored = self._scored_frames
        return Standing(
            frame=frames,
            num_frames=self._num_frames,
            share=min(self._done / self._total, 1.0),
            gone_s=gone_s,
            left_s=left_s,
            psnr_db=self._psnr_sum_db / scored if scored else None,
            bytes_per_frame=self._played_bytes / frames if frames else None,
            iterations_per_s=self._done / gone_s if self._done else None,
        )
