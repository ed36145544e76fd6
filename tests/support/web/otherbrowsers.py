"""Chromium, Firefox and a WebKit, as distributions ship them, with the player's pages."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.support.screen.xserver import x_server
from tests.support.web.chromium import Page, running_chromium, why_not
from tests.support.web.nodeprocess import NO_PACKAGES, NODE, PACKAGES, running_script

FIREFOX = shutil.which("firefox-esr") or shutil.which("firefox")
WEBKIT_DRIVER = shutil.which("WebKitWebDriver")
MINI_BROWSERS = sorted(Path("/usr").glob("lib*/**/webkit2gtk-4.*/MiniBrowser"))


def _command(kind: str) -> list[str]:
    """The arguments of otherbrowsers.mjs. Skips the test where there is no such browser."""
    if NODE is None or not (PACKAGES / "puppeteer-core").is_dir():
        pytest.skip(NO_PACKAGES)
    if kind == "firefox":
        if FIREFOX is None:
            pytest.skip("needs Firefox: apt-get install firefox-esr")
        return [kind, FIREFOX]
    if WEBKIT_DRIVER is None or not MINI_BROWSERS:
        pytest.skip("needs a WebKit: apt-get install webkit2gtk-driver")
    return [kind, str(MINI_BROWSERS[-1]), WEBKIT_DRIVER]


@contextmanager
def running_browser(kind: str) -> Iterator[Page]:
    """kind: chromium, firefox or webkit. Its page can `open`, `run`, `wait`, `press` and `drag`."""
    if kind == "chromium":
        if reason := why_not():
            pytest.skip(reason)
        with running_chromium() as page:
            yield page
        return
    command = _command(kind)
    with x_server() as display, pytest.MonkeyPatch.context() as patch:
        patch.setenv("DISPLAY", display)
        with running_script("otherbrowsers.mjs", *command) as node:
            yield Page(node)
