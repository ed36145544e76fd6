"""How well a window keeps up, as its overlay says it. Pure: times come in as arguments."""

from __future__ import annotations

from collections import deque

from player.playout.conductor import PlayState
from player.playout.timeline import FrameRecord
from player.render.steptimes import StepTimes

WINDOW_S = 1.0
"""Seconds that the figures are of."""


class PlayMeter:
    """Frames drawn and missed in the last second, and what each took."""

    def __init__(self) -> None:
        self._frames: deque[tuple[float, bool]] = deque()  # when, and whether drawn
        self._took_ms: dict[str, float] = {}  # smoothed
        self._last: FrameRecord | None = None
        self.stalls = 0
        self.concealed = 0

    def shown(self, record: FrameRecord, drawn: bool, now_s: float) -> None:
        """A frame was drawn, or passed over. now_s: of the world's time."""
        self._frames.append((now_s, drawn))
        self._last = record
        self.stalls += record.late
        self.concealed += record.concealed
        self._smooth("decode", 1e3 * record.decode_s)

    def took(self, times: StepTimes) -> None:
        """Times of the steps of a picture."""
        if times.upload_ms:
            self._smooth("upload", times.upload_ms)
        self._smooth("sort", times.sort_ms)
        self._smooth("draw", times.draw_ms)

    def _smooth(self, what: str, ms: float) -> None:
        before_ms = self._took_ms.get(what, ms)
        self._took_ms[what] = before_ms + 0.1 * (ms - before_ms)

    def lines(
        self, state: PlayState, num_layers: int, fps: float, rate_bps: float | None, now_s: float
    ) -> list[str]:
        """Lines of the overlay. rate_bps: the estimated rate of the link, if it is known."""
        while self._frames and self._frames[0][0] < now_s - WINDOW_S:
            self._frames.popleft()
        drawn = sum(one for _, one in self._frames)
        layers = self._last.layers if self._last is not None else 0.0
        buffer_s = max(0, state.buffered_until - 1 - state.frame) / fps
        link = "" if rate_bps is None else f", link {rate_bps / 1e6:.1f} Mbit/s"
        moves = "playing" if state.running else "paused"
        if state.seeking:
            moves = "seeking"
        loop = ", looping" if state.loops else ""
        took = ", ".join(f"{what} {ms:.1f}" for what, ms in self._took_ms.items())
        return [
            f"frame {state.frame} of {state.end_frame}, {state.frame / fps:.2f} s, {moves}"
            f" x{state.rate:g}{loop}",
            f"{layers:.2f} of {num_layers} layers, buffer {buffer_s:.1f} s{link}",
            f"{drawn} frames drawn and {len(self._frames) - drawn} missed in the last second, "
            f"{self.stalls} stalls, {self.concealed} concealed",
            f"ms: {took}",
        ]
