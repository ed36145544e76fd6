"""The browser player refuses a stream whose manifest claims 2^24 Gaussians, unless that is
allowed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from urllib.parse import quote

import pytest

from codec.errors import UnsupportedError
from tests.support.hosted_streams import served, static_host
from tests.support.slots.many import NUM_GAUSSIANS, write_many
from tests.support.web.browsercode import BrowserCode
from tests.support.web.chromium import Page

ROOT = Path(__file__).parents[4]
REFUSAL = r"has 16,777,216 Gaussians; max-gaussians=16777216, .* \(about 4\.7 GB of memory\)"
PLAYER = "document.querySelector('swings-player')"


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("library")
    write_many(folder / "many")
    (folder / "web").symlink_to(ROOT / "player" / "web")
    return folder


@contextmanager
def on_static_host(library: Path) -> Iterator[str]:
    with static_host(library) as host:
        yield f"{host}/many/"


@contextmanager
def on_server(library: Path) -> Iterator[str]:
    with served(library) as server:
        yield f"{server.url}/watch/many/"


@pytest.mark.parametrize("host", [on_static_host, on_server])
def test_opening_it(
    browser: BrowserCode, library: Path, host: Callable[[Path], AbstractContextManager[str]]
) -> None:
    with host(library) as url:
        for most in (None, NUM_GAUSSIANS - 1):
            with pytest.raises(UnsupportedError, match=REFUSAL):
                browser.ask("open", url=url, maxGaussians=most)
        found = browser.ask("open", url=url, maxGaussians=NUM_GAUSSIANS)
        assert found["numGs"] == NUM_GAUSSIANS
        assert found["peakMb"] < 400


def test_the_page_says_so_and_its_address_allows_more(page: Page, library: Path) -> None:
    with static_host(library) as host:
        watch = f"{host}/web/watch.html?src={quote(f'{host}/many')}"
        page.open(watch)
        page.wait(f"{PLAYER}.error", 60)
        assert "has 16,777,216 Gaussians; max-gaussians=16777216" in page.run(
            f"return {PLAYER}.error.message"
        )
        # If allowed, it fails at the next step: the device's textures, or objects without gzip.
        page.open(f"{watch}&max-gaussians={NUM_GAUSSIANS}&autoplay=0")
        page.wait(f"{PLAYER}.error", 60)
        told = page.run(f"return {PLAYER}.error.message")
        assert "need a texture" in told or "export --static" in told
