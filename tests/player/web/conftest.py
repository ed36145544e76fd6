from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.support.web.browsercode import BrowserCode, running_code
from tests.support.web.chromium import Page, running_chromium, why_not
from tests.support.web.nodeprocess import NODE


@pytest.fixture(scope="module")
def browser() -> Iterator[BrowserCode]:
    """The code of player/web in a process of Node."""
    if NODE is None:
        pytest.skip("needs Node.js: apt-get install nodejs")
    with running_code() as running:
        yield running


@pytest.fixture(scope="session")
def chromium() -> Iterator[Page]:
    """Chromium, with one page at a time."""
    reason = why_not()
    if reason is not None:
        pytest.skip(reason)
    with running_chromium() as running:
        yield running


@pytest.fixture(scope="module")
def page(chromium: Page) -> Iterator[Page]:
    """A page in Chromium."""
    yield chromium
    chromium.close()  # a page that keeps playing would slow down all other tests
