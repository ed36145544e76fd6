"""Pictures of the browser player in each of its states, and of the server's pages, on a phone, a
laptop and a large screen.

    scripts/bench states FOLDER [--states menu ended gallery-of-200] [--screens phone]

Look at them after each change of the controls or the pages.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro

from codec.console import run_command
from codec.errors import InvalidError
from codec.stream.poster import POSTER_NAME, write_poster
from player.render.cpu import render_splats
from tests.support.hosted_streams import ring_of_cameras, served, wait_for_stream, write_stream
from tests.support.web.chromium import Page, running_chromium, why_not
from tests.support.web.playerstates import SCREENS, STATES, Reached, Screen, hosting, open_on


@contextlib.contextmanager
def serving(folder: Path, count: int) -> Iterator[str]:
    """Runs a swings server with `count` streams of one scene, named s0, s1, ...; gives its URL."""
    cameras = tuple(camera.scaled(10) for camera in ring_of_cameras())
    first = write_stream(folder / "s0", 60, cameras=cameras, poster=POSTER_NAME)
    write_poster(first, render_splats)
    manifest = json.loads((first / "manifest.json").read_text())
    for n in range(count):
        stream = folder / f"s{n}"
        if n > 0:
            shutil.copytree(first, stream)
        title = "A walk through the long hall and back again, take" if n % 3 else "Take"
        text = json.dumps({**manifest, "title": f"{title} {n + 1}"})
        (stream / "manifest.json").write_text(text)
    with served(folder) as server:
        wait_for_stream(server, f"s{count - 1}")
        yield server.url


def _front(page: Page, url: str, screen: Screen) -> None:
    open_on(page, url, screen)
    page.wait("document.images[0]?.naturalWidth > 0")


def _watch(page: Page, url: str, screen: Screen) -> None:
    open_on(page, f"{url}/watch/s0?autoplay=0", screen)
    page.wait("player.shownFrame >= 0")


def _embed(page: Page, url: str, screen: Screen) -> None:
    _watch(page, url, screen)
    page.click("button[popovertarget=embed]")
    page.wait("document.querySelector('#embed').matches(':popover-open')")


PAGES: dict[str, tuple[int, Callable[[Page, str, Screen], None]]] = {
    "gallery-of-1": (1, _front),
    "gallery-of-200": (200, _front),
    "watch": (1, _watch),
    "watch-embed": (1, _embed),
}
"""Number of streams of the server, and function that opens the page."""


@dataclass(frozen=True, slots=True)
class StatesConfig:
    """Writes pictures of the browser player in each of its states, and of the server's pages."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder for the pictures, STATE-SCREEN.png."""
    states: tuple[str, ...] = (*STATES, *PAGES)
    """States and pages to show."""
    screens: tuple[str, ...] = tuple(screen.name for screen in SCREENS)
    """Screens to show them on."""


def run(config: StatesConfig) -> None:
    reason = why_not()
    if reason is not None:
        raise InvalidError(reason)
    config.folder.mkdir(parents=True, exist_ok=True)
    with (
        tempfile.TemporaryDirectory() as streams,
        hosting(Path(streams)) as hosts,
        running_chromium() as page,
    ):
        screens = [screen for screen in SCREENS if screen.name in config.screens]

        def show(state: str, screen: Screen, reach: Callable[[], None], part: str | None) -> None:
            reach()
            page.screenshot(config.folder / f"{state}-{screen.name}.png")
            found = "; ".join(page.axe(part)) or "accessible"
            print(f"{state:24} {screen.name:8} {found}", flush=True)

        for state in config.states:
            if state in STATES:
                for screen in screens:
                    reached = Reached(page, hosts, screen)
                    show(state, screen, partial(reached.reach, STATES[state]), "swings-player")
            else:
                count, reach = PAGES[state]
                with tempfile.TemporaryDirectory() as root, serving(Path(root), count) as url:
                    for screen in screens:
                        show(state, screen, partial(reach, page, url, screen), None)


if __name__ == "__main__":
    run_command(StatesConfig, run, "scripts/bench states", "Shows the player and the pages.")
