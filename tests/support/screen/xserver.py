"""An X server without a screen, and a simulated user with keys, a mouse and screenshots."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

XVFB = shutil.which("Xvfb")
PATIENCE_S = 30.0

Pixels = npt.NDArray[np.uint8]


@contextmanager
def x_server() -> Iterator[str]:
    """Runs an X server; gives the name of its display."""
    if XVFB is None:
        pytest.skip("needs Xvfb, an X server without a screen")
    reading, writing = os.pipe()
    command = [XVFB, "-displayfd", str(writing), "-screen", "0", "640x480x24", "-nolisten", "tcp"]
    process = subprocess.Popen(command, pass_fds=(writing,), stderr=subprocess.DEVNULL)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        number = pipe.readline().strip()
    try:
        yield f":{number}"
    finally:
        process.terminate()
        process.wait()


class Person:
    """A user in front of the window whose title begins with `title`."""

    def __init__(self, display: str, title: str) -> None:
        xlib = pytest.importorskip("Xlib", reason="needs python-xlib")
        from Xlib import XK, X
        from Xlib.display import Display
        from Xlib.ext import xtest

        assert xlib
        self._x, self._keys, self._xtest = X, XK, xtest
        self._display: Any = Display(display)
        self._root = self._display.screen().root
        self._window: Any = self.wait_for(lambda: self._find(title))
        # There is no window manager to set the focus.
        self._window.set_input_focus(X.RevertToParent, X.CurrentTime)
        self._display.sync()

    def _find(self, title: str) -> Any:
        from Xlib.error import XError

        for window in self._root.query_tree().children:
            try:
                name, seen = window.get_wm_name(), window.get_attributes().map_state
            except XError:
                continue  # the window is gone
            if name and name.startswith(title) and seen == self._x.IsViewable:
                return window
        return None

    def wait_for(self, look: Callable[[], Any]) -> Any:
        """The first true result of `look`, which is called repeatedly."""
        until_s = time.monotonic() + PATIENCE_S
        while not (found := look()):
            assert time.monotonic() < until_s, "it did not come to be"
            time.sleep(0.02)
        return found

    @property
    def size_px(self) -> tuple[int, int]:
        geometry = self._window.get_geometry()
        return geometry.width, geometry.height

    def sees(self) -> Pixels:
        """(H, W, 3) uint8 RGB picture of the window."""
        width, height = self.size_px
        image = self._window.get_image(0, 0, width, height, self._x.ZPixmap, 0xFFFFFFFF)
        bgrx = np.frombuffer(image.data, np.uint8).reshape(height, width, 4)
        return np.ascontiguousarray(bgrx[:, :, 2::-1])

    def sees_rest(self) -> Pixels:
        """Picture of the window once it has not changed for a while."""

        def rests() -> Pixels | None:
            before = self.sees()
            time.sleep(0.3)
            now = self.sees()
            return now if before.shape == now.shape and (before == now).all() else None

        found: Pixels = self.wait_for(lambda: [one] if (one := rests()) is not None else [])[0]
        return found

    def presses(self, *names: str) -> None:
        """Presses the last key while the others are held; names are those of X, like `space`."""
        codes = [self._display.keysym_to_keycode(self._keys.string_to_keysym(n)) for n in names]
        assert all(codes), names
        for code in codes:
            self._xtest.fake_input(self._display, self._x.KeyPress, code)
        for code in reversed(codes):
            self._xtest.fake_input(self._display, self._x.KeyRelease, code)
        self._display.sync()
        time.sleep(0.05)

    def holds(self, name: str, seconds: float) -> None:
        """Holds one key for this time."""
        code = self._display.keysym_to_keycode(self._keys.string_to_keysym(name))
        self._xtest.fake_input(self._display, self._x.KeyPress, code)
        self._display.sync()
        time.sleep(seconds)
        self._xtest.fake_input(self._display, self._x.KeyRelease, code)
        self._display.sync()

    def points(self, x_px: int, y_px: int) -> None:
        at = self._window.translate_coords(self._root, 0, 0)
        # `at` is the negative place of the window on the screen.
        self._xtest.fake_input(self._display, self._x.MotionNotify, x=x_px - at.x, y=y_px - at.y)
        self._display.sync()
        time.sleep(0.05)

    def drags(self, button: int, *places: tuple[int, int]) -> None:
        """Drags from the first place over the others to the last. Buttons: 1 left, 2 middle,
        3 right; 4 and 5 are the wheel."""
        self.points(*places[0])
        self._xtest.fake_input(self._display, self._x.ButtonPress, button)
        self._display.sync()
        time.sleep(0.05)
        for place in places[1:]:
            self.points(*place)
        self._xtest.fake_input(self._display, self._x.ButtonRelease, button)
        self._display.sync()
        time.sleep(0.05)

    def close(self) -> None:
        self._display.close()
