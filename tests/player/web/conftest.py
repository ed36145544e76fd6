from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.support.hosted_streams import ServerProcess, served, wait_for_stream
from tests.support.suite.once import made_once
from tests.support.web.browsercode import BrowserCode, running_code
from tests.support.web.chromium import Page, running_chromium, why_not
from tests.support.web.nodeprocess import NODE
from tests.support.web.site import Site, player_host, write_streams

ENDS_OF_HOSTS = (
    "ERR_CONNECTION_REFUSED",
    "ERR_CONNECTION_RESET",
    "ERR_EMPTY_RESPONSE",
    "ERR_SOCKET_NOT_CONNECTED",
    "there is no motion between frames, its code is missing",
)
"""Complaints about a test's own host, which may end before its page does."""

NO_GESTURE = "AudioContext was not allowed to start"
"""What Chromium says of sound before a person has touched the page."""


@pytest.fixture(scope="module")
def browser() -> Iterator[BrowserCode]:
    """The code of player/web in a process of Node."""
    if NODE is None:
        pytest.skip("needs Node.js: apt-get install nodejs")
    with running_code() as running:
        yield running


@pytest.fixture(scope="session")
def chromium() -> Iterator[Page]:
    """Chromium, started once for each process of the suite, with one page at a time."""
    reason = why_not()
    if reason is not None:
        pytest.skip(reason)
    with running_chromium(keeps_page=True) as running:
        yield running


@pytest.fixture
def page(chromium: Page) -> Iterator[Page]:
    """A page in Chromium. A test whose page complains fails, unless it expects that."""
    yield chromium
    chromium.rest()  # a page that keeps playing would slow down all other tests
    known = *ENDS_OF_HOSTS, NO_GESTURE
    complaints = chromium.take_complaints()
    assert [one for one in complaints if not any(text in one for text in known)] == []


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    folder = tmp_path_factory.mktemp("site")
    for path in made_once(tmp_path_factory, "web-site", write_streams).iterdir():
        (folder / path.name).symlink_to(path)
    with player_host(folder) as url:
        yield Site(url, folder)


@pytest.fixture(scope="session")
def server(site: Site) -> Iterator[ServerProcess]:
    """A swings server of the site's streams."""
    with served(site.folder / "trained") as running:
        for name in ("clip", "long", "whole"):
            wait_for_stream(running, name)
        yield running
