"""A page in a browser, driven by playwright-core like by a user."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from tests.support.waiting import BOUND_S
from tests.support.web.nodeprocess import (
    NO_PACKAGES,
    NODE,
    PACKAGES,
    Json,
    NodeProcess,
    running_script,
)

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
SHELL = shutil.which("chromium-headless-shell")
"""Chromium without its own window, whose pages cost a quarter less."""


def why_not() -> str | None:
    """The reason why there is no browser; None if there is one."""
    if NODE is None or not (PACKAGES / "playwright-core").is_dir():
        return NO_PACKAGES
    if CHROMIUM is None and SHELL is None:
        return "needs Chromium: apt-get install chromium"
    return None


class Page:
    """One page."""

    def __init__(self, node: NodeProcess) -> None:
        self._node = node
        self._expected: list[str] = []

    def _do(self, kind: str, **question: object) -> Json:
        answer = self._node.answer(kind, question)
        assert "failed" not in answer, f"{answer['failed']}\n{answer['complaints']}"
        return answer["value"]

    def open(
        self,
        url: str,
        width_px: int = 640,
        height_px: int = 480,
        touch: bool = False,
        scripts: Sequence[Path] = (),
        options: dict[str, object] | None = None,
    ) -> None:
        """scripts: run in the page before its own scripts. options: of Playwright's browser
        context, such as deviceScaleFactor, reducedMotion and forcedColors."""
        size = {"widthPx": width_px, "heightPx": height_px}
        paths = [str(path) for path in scripts]
        self._do("open", url=url, **size, touch=touch, scripts=paths, options=options or {})

    def reopen(self, rest_s: float = 0) -> None:
        """Opens the same address in a new page of the same browser, with a warm cache, `rest_s`
        after closing the old page."""
        self._do("reopen", restS=rest_s)

    def close(self) -> None:
        """Ends the page and its process; the next one is opened in another."""
        self._do("close")

    def rest(self) -> None:
        """Leaves the page."""
        self._do("rest")

    def enter(self, part: str) -> None:
        """Enters the frame whose URL contains `part`; later runs, waits and clicks act on it."""
        self._do("enter", part=part)

    def run(self, code: str, value: object = None) -> Json:
        """The result of `code`, the body of an async function of `value`. It may name the `element`
        <swings-player>, its `player` and `state`, and a `part(selector)` of its shadow tree."""
        return self._do("run", code=code, value=value)

    def value(self, code: str) -> Json:
        """The value of the expression `code`, which may name what `run` may."""
        return self.run(f"return {code}")

    def wait(self, code: str, timeout_s: float = BOUND_S) -> None:
        """Waits until the expression `code` is true, which may name what `run` may."""
        self._do("wait", code=code, timeoutS=timeout_s)

    def wait_until_still(self, code: str, looks: int = 40) -> None:
        """Waits until the expression `code` has had the same value at so many looks in a row, which
        are 30 ms apart, or more where the page is slow."""
        look = f"JSON.stringify({code})"
        self.run(f"window.looked = {{ text: {look}, times: 0 }}")
        same = f"looked.text === (looked.text = {look})"
        self.wait(f"(looked.times = {same} ? looked.times + 1 : 0) >= {looks}")

    def press(self, key: str) -> None:
        self._do("press", key=key)

    def click(self, selector: str) -> None:
        self._do("click", selector=selector)

    def tap(self, at_px: tuple[float, float]) -> None:
        """Taps the page with a finger."""
        self._do("tap", atPx=at_px)

    def wheel(self, at_px: tuple[float, float]) -> None:
        """Turns the wheel away from the person by one step."""
        self._do("wheel", atPx=at_px)

    def drag(
        self, from_px: tuple[float, float], to_px: tuple[float, float], button: str = "left"
    ) -> None:
        self._do("drag", fromPx=from_px, toPx=to_px, button=button)

    def touch(self, *steps: Sequence[tuple[float, float]]) -> None:
        """Moves fingers from the places of each step to those of the next, in pixels."""
        self._do("touch", steps=steps)

    def screenshot(self, path: Path, selector: str | None = None) -> None:
        self._do("screenshot", path=str(path), selector=selector)

    def axe(self, selector: str | None = None) -> list[str]:
        """Complaints of axe-core about a part of the page, or all of it; a line per element."""
        found: list[str] = self._do("axe", selector=selector)
        return found

    def resize(self, width_px: int, height_px: int) -> None:
        self._do("resize", widthPx=width_px, heightPx=height_px)

    def set_screen(self, width_px: int, height_px: int, ratio: float) -> None:
        """Moves the window to a screen with `ratio` device pixels for each CSS pixel; Chromium
        reports the ratio to the page only if the size changes as well."""
        self._do("screen", widthPx=width_px, heightPx=height_px, ratio=ratio)

    def set_offline(self, offline: bool) -> None:
        self._do("offline", offline=offline)

    def heaps_bytes(self) -> list[int]:
        """Bytes in the heaps of the page and each of its workers, after garbage collection."""
        found: list[int] = self._do("heaps")
        return found

    def expect(self, *texts: str) -> None:
        """Complaints with any of `texts` are expected; see `take_complaints`."""
        self._expected += texts

    def take_complaints(self) -> list[str]:
        """The complaints that nothing expected; forgets them, and what was expected."""
        expected, self._expected = self._expected, []
        found: list[str] = self._do("takeComplaints")
        return [line for line in found if not any(text in line for text in expected)]


@contextmanager
def running_chromium(keeps_page: bool = False) -> Iterator[Page]:
    """keeps_page: pages with the same options are opened one after another in one process, of the
    shell where there is one. Otherwise it is the browser that people have."""
    path = (SHELL or CHROMIUM) if keeps_page else (CHROMIUM or SHELL)
    assert path is not None
    how = ("chromium", path, f"{BOUND_S}", "keep" if keeps_page else "")
    with running_script("drive.mjs", *how) as node:
        yield Page(node)
