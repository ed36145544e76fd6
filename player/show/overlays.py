"""Which overlays a window shows, and where; each is drawn anew only when it changes."""

from __future__ import annotations

from collections.abc import Callable

from codec.arrays import Doubles
from player.playout.conductor import Conductor, PlayState

from .captionchoice import CaptionChoice
from .controls import HELP, Controls
from .overlay import BAR_PX, MARGIN_PX, Pixels, Placed, caption_panel, seek_bar, text_panel
from .playmeter import PlayMeter

Make = Callable[[], tuple[Pixels, tuple[int, int]]]

INFO_EVERY_S = 0.25
"""Seconds between two updates of the figures: faster, they cannot be read."""


class Overlays:
    """The info at the top, the help below it, the bar at the bottom, captions above that."""

    def __init__(self, meter: PlayMeter, fps: float, captions: CaptionChoice) -> None:
        self._meter, self._fps, self._captions = meter, fps, captions
        self._held: dict[str, tuple[object, Placed]] = {}
        self._info_s = -INFO_EVERY_S

    def now(
        self,
        conductor: Conductor,
        controls: Controls,
        size: tuple[int, int],
        now_s: float,
        pointed: Callable[[], Doubles | None],
    ) -> list[Placed]:
        """Overlays of a picture of `size`. pointed: finds the point, (3,) metres, world, that the
        pointer is on, which takes a moment."""
        state = conductor.state()
        shown, top_px = [], MARGIN_PX
        if controls.shows_info:
            if now_s - self._info_s >= INFO_EVERY_S or "info" not in self._held:
                self._info_s = now_s
                info = self._text("info", self._lines(conductor, state, now_s, pointed()), top_px)
            else:
                info = self._held["info"][1]
            shown.append(info)
            top_px += info.pixels.shape[0] + MARGIN_PX
        if controls.shows_help:
            shown.append(self._text("help", HELP, top_px))
        if controls.shows_bar and size[1] > BAR_PX:
            shown.append(self._bar(state, size))
        if (lines := self._captions.lines(state.frame / self._fps)) and all(size):
            shown.append(self._caption(lines, size))
        return shown

    def _caption(self, lines: tuple[str, ...], size: tuple[int, int]) -> Placed:
        def make() -> tuple[Pixels, tuple[int, int]]:
            pixels = caption_panel(lines, size)
            height_px, width_px, _ = pixels.shape
            top_px = max(0, size[1] - BAR_PX - MARGIN_PX - height_px)
            return pixels, ((size[0] - width_px) // 2, top_px)

        return self._keep("captions", (lines, size), make)

    def _lines(
        self, conductor: Conductor, state: PlayState, now_s: float, point: Doubles | None
    ) -> tuple[str, ...]:
        source = conductor.source
        lines = self._meter.lines(
            state, source.manifest.num_layers, self._fps, source.play.rate_bps, now_s
        )
        at = "-" if point is None else " ".join(f"{metres:.3f}" for metres in point)
        return (*lines, f"pointer on {at}")

    def _text(self, place: str, lines: tuple[str, ...], top_px: int) -> Placed:
        key = (lines, top_px)
        return self._keep(place, key, lambda: (text_panel(lines), (MARGIN_PX, top_px)))

    def _bar(self, state: PlayState, size: tuple[int, int]) -> Placed:
        width_px, height_px = size
        key = (state, size)
        corner_px = (0, height_px - BAR_PX)
        return self._keep("bar", key, lambda: (seek_bar(width_px, state), corner_px))

    def _keep(self, place: str, key: object, make: Make) -> Placed:
        held = self._held.get(place)
        if held is not None and held[0] == key:
            return held[1]
        pixels, corner_px = make()
        version = held[1].version + 1 if held is not None else 0
        placed = Placed(place, pixels, corner_px, version)
        self._held[place] = (key, placed)
        return placed
