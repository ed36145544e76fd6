"""Progress line and log while parts are trained and joined."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

from codec.progressline import ProgressLine
from codec.stream.index import SegmentRecord
from trainer.run.runlog import RunLog
from trainer.run.runstatus import RunStatus


class JoinMonitor:
    """Shows all iterations of all workers on a progress line, and logs every segment that has
    joined the stream."""

    def __init__(
        self,
        line: ProgressLine,
        log: RunLog,
        num_frames: int,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._line, self._log, self._num_frames, self._now_s = line, log, num_frames, now_s
        self._begin_s, self._total, self._done, self._before = now_s(), 1, 0, 0
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

    def progressed(self, iterations: int, before: int = 0) -> None:
        """All workers together have done so many, `before` of them in an earlier run."""
        self._done, self._before = iterations, before
        self._line.show(self._status().stage())

    def joined(self, records: Sequence[SegmentRecord]) -> None:
        """These have joined the stream now."""
        for record in records:
            self._count(record)
            status = self._status()
            self._log.add(status.log_row() | {"frame": self._frames - 1})
            self._line.show(status.stage())

    def _count(self, record: SegmentRecord) -> None:
        self._frames = record.first_frame + record.num_frames
        self._played_bytes += record.played_bytes
        if not math.isnan(record.psnr_db[-1]):
            self._scored_frames += record.num_frames
            self._psnr_sum_db += record.num_frames * record.psnr_db[-1]

    def _status(self) -> RunStatus:
        elapsed_s, frames = self._now_s() - self._begin_s, self._frames
        now_done = self._done - self._before
        left_s = elapsed_s / now_done * (self._total - self._done) if now_done else None
        scored = self._scored_frames
        return RunStatus(
            frame=frames,
            num_frames=self._num_frames,
            share=min(self._done / self._total, 1.0),
            elapsed_s=elapsed_s,
            left_s=left_s,
            psnr_db=self._psnr_sum_db / scored if scored else None,
            bytes_per_frame=self._played_bytes / frames if frames else None,
            iterations_per_s=now_done / elapsed_s if now_done else None,
        )
