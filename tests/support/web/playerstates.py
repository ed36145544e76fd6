"""The states of the browser player, each reached like by a user."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from codec.stream.poster import POSTER_NAME, write_poster
from codec.stream.storyboard import STORYBOARD_NAME, write_storyboard
from codec.tools.static import export_static
from player.render.cpu import render_splats
from tests.support.hosted_streams import ring_of_cameras, write_stream
from tests.support.web.chromium import Page
from tests.support.web.publisher import Publisher
from tests.support.web.site import player_host

NUM_FRAMES = 120
NO_WEBGL = """
const { getContext } = HTMLCanvasElement.prototype;
HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
  return kind === "webgl2" ? null : getContext.call(this, kind, ...rest);
};
"""


@dataclass(frozen=True, slots=True)
class Screen:
    """Screen of a device."""

    name: str
    width_px: int
    height_px: int
    touch: bool = False
    scale: int = 1


SCREENS = (
    Screen("phone", 390, 844, touch=True, scale=3),
    Screen("laptop", 1440, 900),
    Screen("large", 2560, 1440),
)


def open_on(
    page: Page,
    url: str,
    screen: Screen,
    scripts: Sequence[Path] = (),
    options: Mapping[str, object] | None = None,
) -> None:
    """Opens a page on a screen; scripts and options as of `Page.open`."""
    context = {"deviceScaleFactor": screen.scale, "isMobile": screen.touch, **(options or {})}
    page.open(url, screen.width_px, screen.height_px, screen.touch, scripts, context)


@dataclass(frozen=True, slots=True)
class Hosts:
    """Hosts of the streams."""

    url: str
    silent_url: str
    """A host that accepts connections and never answers."""
    folder: Path


def write_hosted(folder: Path) -> None:
    """Writes a clip with pictures to static/, and to live/ a live stream whose writer has stopped
    after two segments."""
    stream = write_stream(
        folder / "stream",
        NUM_FRAMES,
        cameras=tuple(camera.scaled(10) for camera in ring_of_cameras()),
        poster=POSTER_NAME,
        storyboard=STORYBOARD_NAME,
    )
    write_poster(stream, render_splats)
    write_storyboard(stream, render_splats)
    export_static(stream, folder / "static")
    export_static(write_stream(folder / "bare", 30), folder / "exported")
    Publisher(folder / "exported", folder / "live").publish(2)


@contextlib.contextmanager
def hosting(folder: Path) -> Iterator[Hosts]:
    """Hosts the player and the streams of `write_hosted`, which it writes unless they are there."""
    if not (folder / "static").exists():
        write_hosted(folder)
    with socket.create_server(("127.0.0.1", 0)) as silent, player_host(folder) as url:
        yield Hosts(url, f"http://127.0.0.1:{silent.getsockname()[1]}/stream", folder)


@dataclass(frozen=True, slots=True)
class Reached:
    """A page in Chromium, with methods to open the player in it."""

    page: Page
    hosts: Hosts
    screen: Screen

    def watch(self, query: str, script: str | None = None, **options: object) -> None:
        """Opens the player's page with `query`."""
        scripts: list[Path] = []
        if script is not None:
            path = self.hosts.folder / "before.js"
            path.write_text(script, encoding="utf-8")
            scripts.append(path)
        open_on(
            self.page, f"{self.hosts.url}/player/watch.html?{query}", self.screen, scripts, options
        )

    def wait(self, condition: str) -> None:
        """Waits until the player is in this condition."""
        self.page.wait(f"part('.frame').dataset.condition === '{condition}'")

    def click(self, part: str) -> None:
        self.page.wait(f"part('{part}')")
        self.page.run(f"part('{part}').click()")

    def shows(self, part: str) -> None:
        """Waits for a part that is loaded when it is first used, or shows after a while."""
        self.page.wait(f"part('{part}').checkVisibility({{ visibilityProperty: true }})")


def _start(at: Reached) -> None:
    at.watch("src=../static&autoplay=0")
    at.wait("start")


def _loading(at: Reached, **options: object) -> None:
    at.watch("src=../static&autoplay=0", None, **options)
    poster = f"{at.hosts.url}/static/poster.jpg"
    at.page.wait("player")
    at.page.run(f"element.poster = '{poster}'; element.src = '{at.hosts.silent_url}'")
    at.wait("loading")
    at.shows(".spinner")


def _playing(at: Reached) -> None:
    at.watch("src=../static&t=0.5")
    at.wait("playing")


def _idle(at: Reached) -> None:
    at.watch("src=../static")
    at.page.wait("getComputedStyle(part('.bar')).opacity === '0'")


def _paused(at: Reached, **options: object) -> None:
    at.watch("src=../static&t=1", None, **options)
    at.page.wait("player.shownFrame > 35")
    at.page.run("element.pause()")
    at.wait("paused")


def _ended(at: Reached) -> None:
    at.watch("src=../static&loop=0&t=3.5")
    at.wait("ended")


def _waiting(at: Reached) -> None:
    at.watch("src=../live&t=0")
    at.wait("waiting")
    at.shows(".spinner")


def _stopped(at: Reached) -> None:
    at.watch("src=../live&t=0")
    at.page.wait("part('.note.soft').textContent.includes('has stopped')")


def _failed(at: Reached) -> None:
    at.watch("src=../nothing")
    at.wait("failed")


def _failed_details(at: Reached) -> None:
    _failed(at)
    at.click("summary")


def _no_webgl(at: Reached) -> None:
    at.watch("src=../static", NO_WEBGL)
    at.wait("failed")


def _context_lost(at: Reached) -> None:
    _paused(at)
    at.page.run("player.dispatchEvent(new Event('contextlost'))")


def _menu(at: Reached) -> None:
    _paused(at)
    at.click(".more")
    at.shows(".menu")


def _speed(at: Reached) -> None:
    _menu(at)
    at.click("[data-name=rate]")


def _keys(at: Reached) -> None:
    _paused(at)
    at.page.press("?")
    at.shows("dialog")


def _statistics(at: Reached) -> None:
    _paused(at)
    at.page.press("i")
    at.shows(".stats")


def _preview(at: Reached) -> None:
    _paused(at)
    at.page.run("part('.scrub').value = 90; part('.scrub').dispatchEvent(new Event('input'))")
    at.shows(".tile")


def _forced_menu(at: Reached) -> None:
    _paused(at, forcedColors="active")
    at.click(".more")
    at.shows(".menu")


def _still(at: Reached) -> None:
    at.watch("src=../static&autoplay=1", reducedMotion="reduce")
    at.wait("start")


STATES: dict[str, Callable[[Reached], None]] = {
    "start": _start,
    "loading": _loading,
    "playing": _playing,
    "idle": _idle,
    "paused": _paused,
    "ended": _ended,
    "waiting": _waiting,
    "stopped": _stopped,
    "failed": _failed,
    "failed-details": _failed_details,
    "no-webgl": _no_webgl,
    "context-lost": _context_lost,
    "menu": _menu,
    "speed": _speed,
    "keys": _keys,
    "statistics": _statistics,
    "preview": _preview,
    "forced-colours": partial(_paused, forcedColors="active"),
    "forced-menu": _forced_menu,
    "reduced-motion": _still,
    "reduced-motion-loading": partial(_loading, reducedMotion="reduce"),
}
"""Functions that reach the states, by name."""
