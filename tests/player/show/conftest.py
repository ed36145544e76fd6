"""A user in front of windows on an X server of these tests."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator

import pytest

from tests.player.show.windowed import Person
from tests.support.screen.xserver import x_server


@pytest.fixture(scope="session")  # what drew on a server that has ended cannot go on
def display() -> Iterator[str]:
    with x_server() as name:
        yield name


@pytest.fixture
def person(display: str, monkeypatch: pytest.MonkeyPatch) -> Person:
    monkeypatch.setenv("DISPLAY", display)
    ctypes.CDLL("libEGL.so.1").eglReleaseThread()  # GLX refuses a thread that draws by EGL
    return Person(monkeypatch)
