"""A user in front of windows on an X server of these tests."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.player.show.windowed import Person
from tests.support.screen.xserver import x_server


@pytest.fixture(scope="package")
def display() -> Iterator[str]:
    with x_server() as name:
        yield name


@pytest.fixture
def person(display: str, monkeypatch: pytest.MonkeyPatch) -> Person:
    monkeypatch.setenv("DISPLAY", display)
    return Person(monkeypatch)
