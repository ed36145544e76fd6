"""Keys and mouse of the window: what a person does becomes commands, and a View.

Rule: belongs to the main thread, as glfw wants it. Nothing here waits.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import glfw

from codec.camera import Camera
from player.playout.conductor import Conductor
from player.view.mouse import View

from .captionchoice import CaptionChoice
from .overlay import BAR_PX, frame_at

if TYPE_CHECKING:
    from player.sound.soundplayer import SoundPlayer

SKIP_S, FAR_SKIP_S = 1.0, 5.0
"""Seconds of media that an arrow skips, without and with shift."""

BAR_S = 2.0
"""Seconds for which the bar stays when the mouse has rested."""

VOLUME_STEP = 0.1
"""Change of the volume for one press of a key; 1 is the full volume."""

FLY_PER_S = 0.5
"""Distances to the scene's centre that one flies in a second."""

HELP = (
    "space\tpause or play",
    "left, right\tskip back or forward by 1 s (with shift 5 s)",
    "comma, period\tstep one frame back or forward",
    "home, end\tgo to the first or newest frame",
    "[  ]\tslower, faster; backspace: normal speed",
    "L\tloop on or off",
    "M\tsound off or on; up, down: louder, softer",
    "C\tcaptions: the next language, or none",
    "B\tmotion between frames on or off",
    "F\tfull screen; escape: leave it, or close the window",
    "I\tplayback statistics",
    "R\treturn to the path's camera",
    "W A S D Q E\tfly",
    "left drag\tturn; right drag: move; wheel: nearer or farther",
    "touchpad\tup or down: nearer or farther; sideways: turn",
    "H\tthis help",
)


class Controls:
    """`changes` goes up with whatever changes the picture."""

    def __init__(
        self,
        window: Any,
        conductor: Conductor,
        view: View,
        focal_px: float,
        captions: CaptionChoice,
        sound: SoundPlayer | None = None,
    ) -> None:
        self._window, self._conductor, self._sound = window, conductor, sound
        self._view, self._focal_px = view, focal_px
        self._at_px = (0.0, 0.0)
        self._moved_s = -BAR_S
        self._seeks_by_bar = False
        self._windowed: tuple[int, int, int, int] | None = None  # place and size to go back to
        self.changes = 0
        self.shows_info = self.shows_help = False
        self._keys: dict[int, Callable[[int], None]] = {
            glfw.KEY_SPACE: lambda _: conductor.toggle_pause(),
            glfw.KEY_LEFT: lambda modifiers: conductor.skip(-_skip_s(modifiers)),
            glfw.KEY_RIGHT: lambda modifiers: conductor.skip(_skip_s(modifiers)),
            glfw.KEY_COMMA: lambda _: conductor.step(-1),
            glfw.KEY_PERIOD: lambda _: conductor.step(1),
            glfw.KEY_HOME: lambda _: conductor.seek(0),
            glfw.KEY_END: lambda _: conductor.seek_newest(),
            glfw.KEY_LEFT_BRACKET: lambda _: conductor.change_rate(-1),
            glfw.KEY_RIGHT_BRACKET: lambda _: conductor.change_rate(1),
            glfw.KEY_BACKSPACE: lambda _: conductor.change_rate(0),
            glfw.KEY_L: lambda _: conductor.toggle_loop(),
            glfw.KEY_M: lambda _: self._toggle_sound(),
            glfw.KEY_UP: lambda _: self._change_volume(VOLUME_STEP),
            glfw.KEY_DOWN: lambda _: self._change_volume(-VOLUME_STEP),
            glfw.KEY_C: lambda _: captions.next(),
            glfw.KEY_B: lambda _: self._toggle_smoothing(),
            glfw.KEY_F: lambda _: self._toggle_full_screen(),
            glfw.KEY_ESCAPE: lambda _: self._escape(),
            glfw.KEY_I: lambda _: self._toggle_info(),
            glfw.KEY_H: lambda _: self._toggle_help(),
            glfw.KEY_R: lambda _: view.reset(),
        }
        glfw.set_cursor_pos_callback(window, self._moved)
        glfw.set_mouse_button_callback(window, self._clicked)
        glfw.set_scroll_callback(window, self._scrolled)
        glfw.set_key_callback(window, self._pressed)
        glfw.set_window_refresh_callback(window, self._damaged)

    @property
    def shows_bar(self) -> bool:
        """Whether the bar is wanted: while time stands, and while the mouse moves."""
        recent = time.monotonic() - self._moved_s < BAR_S
        return recent or self._seeks_by_bar or not self._conductor.state().running

    def pointer_px(self, size: tuple[int, int]) -> tuple[float, float] | None:
        """Where the pointer is in a picture of `size`, from the upper left; None outside."""
        window_px = glfw.get_window_size(self._window)  # of a dense screen not those of its picture
        if not all(0 <= at < most for at, most in zip(self._at_px, window_px, strict=True)):
            return None
        x_px, y_px = (a * n / m for a, n, m in zip(self._at_px, size, window_px, strict=True))
        return x_px, y_px

    def fly(self, camera: Camera, seconds: float) -> None:
        """Flies on from `camera` for `seconds`, if a key says so."""

        def held(key: int) -> int:
            return int(glfw.get_key(self._window, key) == glfw.PRESS)

        right = held(glfw.KEY_D) - held(glfw.KEY_A)
        down = held(glfw.KEY_Q) - held(glfw.KEY_E)
        forward = held(glfw.KEY_W) - held(glfw.KEY_S)
        if right or down or forward:
            share = FLY_PER_S * seconds
            self._view.fly(camera, share * right, share * down, share * forward)
            self.changes += 1

    def _pressed(self, window: Any, key: int, code: int, action: int, modifiers: int) -> None:
        if action == glfw.RELEASE or key not in self._keys:
            return
        repeats = key in (glfw.KEY_LEFT, glfw.KEY_RIGHT, glfw.KEY_COMMA, glfw.KEY_PERIOD)
        if action == glfw.PRESS or repeats:
            self._keys[key](modifiers)
            self.changes += 1

    def _toggle_sound(self) -> None:
        if self._sound is not None:
            self._sound.muted = not self._sound.muted

    def _change_volume(self, more: float) -> None:
        if self._sound is not None:
            self._sound.volume = min(max(self._sound.volume + more, 0.0), 1.0)

    def _toggle_info(self) -> None:
        self.shows_info = not self.shows_info

    def _toggle_smoothing(self) -> None:
        smoothing = self._conductor.smoothing
        smoothing.on = not smoothing.on

    def _toggle_help(self) -> None:
        self.shows_help = not self.shows_help

    def _escape(self) -> None:
        if self._windowed is not None:
            self._toggle_full_screen()
        else:
            glfw.set_window_should_close(self._window, True)

    def _toggle_full_screen(self) -> None:
        if self._windowed is not None:
            left_px, top_px, width_px, height_px = self._windowed
            self._windowed = None
            nowhere: Any = None  # which glfw's annotation leaves out
            glfw.set_window_monitor(self._window, nowhere, left_px, top_px, width_px, height_px, 0)
            return
        monitor = glfw.get_primary_monitor()
        if not monitor:
            return  # there is none to fill
        self._windowed = (*glfw.get_window_pos(self._window), *glfw.get_window_size(self._window))
        mode = glfw.get_video_mode(monitor)
        glfw.set_window_monitor(
            self._window, monitor, 0, 0, mode.size.width, mode.size.height, mode.refresh_rate
        )

    def _held(self, button: int) -> bool:
        return bool(glfw.get_mouse_button(self._window, button) == glfw.PRESS)

    def _moved(self, window: Any, x_px: float, y_px: float) -> None:
        right_px, down_px = x_px - self._at_px[0], y_px - self._at_px[1]
        self._at_px, self._moved_s = (x_px, y_px), time.monotonic()
        self.changes += 1
        if self._seeks_by_bar:
            self._seek_by_bar()
        elif self._held(glfw.MOUSE_BUTTON_RIGHT) or self._held(glfw.MOUSE_BUTTON_MIDDLE):
            self._view.drag_pan(right_px, down_px, self._focal_px)
        elif self._held(glfw.MOUSE_BUTTON_LEFT):
            self._view.drag_turn(right_px, down_px)

    def _clicked(self, window: Any, button: int, action: int, modifiers: int) -> None:
        if button != glfw.MOUSE_BUTTON_LEFT:
            return
        _, height_px = glfw.get_window_size(window)
        on_bar = self.shows_bar and self._at_px[1] >= height_px - BAR_PX
        self._seeks_by_bar = action == glfw.PRESS and on_bar
        if self._seeks_by_bar:
            self._seek_by_bar()

    def _seek_by_bar(self) -> None:
        width_px, _ = glfw.get_window_size(self._window)
        state = self._conductor.state()
        frame = frame_at(self._at_px[0], width_px, state)
        if frame != state.frame:
            self._conductor.seek(frame)

    def _scrolled(self, window: Any, x_steps: float, y_steps: float) -> None:
        self._view.scroll(x_steps, y_steps)
        self.changes += 1

    def _damaged(self, window: Any) -> None:
        self.changes += 1


def _skip_s(modifiers: int) -> float:
    return FAR_SKIP_S if modifiers & glfw.MOD_SHIFT else SKIP_S
