"""A user of the window in this process, who acts between two looks of the window at its events."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import glfw
import numpy as np
import numpy.typing as npt
import pytest

import player.show.window
from player.config import PlayConfig
from player.playout.conductor import Conductor
from player.report.journal import PlaySummary
from player.run.playback import play
from player.show.glwindow import GlWindow
from player.show.overlay import BAR_PX

Pixels = npt.NDArray[np.uint8]
Acts = Iterator[None]
"""What a user does; each `yield` lets the window work once."""


class Person:
    """Keys and mouse come through the callbacks that the window has given to glfw."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.pictures: list[Pixels] = []
        """Everything that was drawn, each (H, W, 3) RGB."""
        self.conductor: Conductor
        self.window: Any = None
        self._callbacks: dict[str, Callable[..., None]] = {}
        self._held: set[object] = set()
        self._acts: Acts = iter(())
        for name in ("cursor_pos", "mouse_button", "scroll", "key"):
            self._note_callback(patch, name)
        poll, swap, show = glfw.poll_events, GlWindow.swap, player.show.window.show_window

        def swap_buffers(window: GlWindow) -> None:
            self.window = window.handle
            width, height = window.size_px
            data = window.context.screen.read((0, 0, width, height), components=3, alignment=1)
            self.pictures.append(np.frombuffer(data, np.uint8).reshape(height, width, 3)[::-1])
            swap(window)

        def poll_events() -> None:
            poll()
            if self.pictures and next(self._acts, self) is self:
                glfw.set_window_should_close(self.window, True)

        def show_window(window: Any, poster: Any, conductor: Conductor, *more: Any, **named: Any):  # type: ignore[no-untyped-def]
            self.conductor = conductor
            return show(window, poster, conductor, *more, **named)

        patch.setattr(GlWindow, "swap", swap_buffers)
        patch.setattr(glfw, "poll_events", poll_events)
        patch.setattr(glfw, "get_key", lambda _, key: int(("key", key) in self._held))
        patch.setattr(glfw, "get_mouse_button", lambda _, which: int(which in self._held))
        patch.setattr(player.show.window, "show_window", show_window)

    def _note_callback(self, patch: pytest.MonkeyPatch, name: str) -> None:
        setter = getattr(glfw, f"set_{name}_callback")

        def note(window: Any, callback: Callable[..., None]) -> object:
            self._callbacks[name] = callback
            return setter(window, callback)

        patch.setattr(glfw, f"set_{name}_callback", note)

    def watches(self, config: PlayConfig, acts: Callable[[Person], Acts]) -> PlaySummary:
        """Plays in a window, which is closed when the acts are over. They begin with the first
        picture, which may be the poster."""
        self._acts = acts(self)
        return play(config)

    @property
    def seen(self) -> Pixels:
        """The picture without the strip of the bar."""
        return self.pictures[-1][:-BAR_PX]

    def differs(self, other: Pixels) -> float:
        """Share of the pixels seen that differ."""
        return float((self.seen != other).any(axis=2).mean())

    def until(self, holds: Callable[[], object]) -> Acts:
        while not holds():
            yield

    def rests(self) -> Acts:
        """Until the picture that was asked for is drawn, and the window has nothing to draw."""
        idle, drawn = 0, -1
        while idle < 3:
            same = len(self.pictures) == drawn and not self.conductor.state().seeking
            idle, drawn = idle + 1 if same else 0, len(self.pictures)
            yield

    def presses(self, key: int, modifiers: int = 0) -> None:
        self._callbacks["key"](self.window, key, 0, glfw.PRESS, modifiers)

    def flies(self, key: int) -> Acts:
        self._held.add(("key", key))
        drawn = len(self.pictures)
        yield from self.until(lambda: len(self.pictures) > drawn + 5)
        self._held.clear()

    def drags(self, button: int, *places: tuple[float, float]) -> None:
        self._callbacks["cursor_pos"](self.window, *places[0])
        self._held.add(button)
        self._callbacks["mouse_button"](self.window, button, glfw.PRESS, 0)
        for place in places[1:]:
            self._callbacks["cursor_pos"](self.window, *place)
        self._held.clear()
        self._callbacks["mouse_button"](self.window, button, glfw.RELEASE, 0)

    def scrolls(self, steps: float) -> None:
        self._callbacks["scroll"](self.window, 0.0, steps)
