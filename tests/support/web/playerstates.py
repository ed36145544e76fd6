"""The states of the browser player, each reached like by a user."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from codec.stream.poster import POSTER_NAME, STORYBOARD_NAME, write_poster, write_storyboard
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
    export_static(write_stream(folder / "one", 1, cameras=ring_of_cameras()), folder / "model")
    export_static(write_stream(folder / "bare", 30), folder / "exported")
    Publisher(folder / "exported", folder / "live").publish(2)


@contextlib.contextmanager
def hosting(folder: Path) -> Iterator[Hosts]:
    """Hosts the player and the streams of `write_hosted`, which it writes unless they are there."""
    if not (folder / "static").exists():
        write_hosted(folder)
    with socket.create_server(("127.0.0.1", 0)) as silent, player_host(folder) as url:
        yield Hosts(url, f"http://127.0.0.1:{silent.getsockname()[1]}/stream", folder)


Step = tuple[str, str]
"""Which of `wait`, `run` and `press` of `Page`, and its argument; SILENT_URL stands for the URL of
the silent host."""


@dataclass(frozen=True, slots=True)
class State:
    """A state of the player: the query of its page, and what happens there."""

    query: str
    steps: Sequence[Step]
    script: str = ""
    """Runs in the page before its own scripts."""
    options: Mapping[str, object] = field(default_factory=dict)
    """Options of `Page.open`."""


@dataclass(frozen=True, slots=True)
class Reached:
    """A page in Chromium, with methods to open the player in it."""

    page: Page
    hosts: Hosts
    screen: Screen

    def watch(self, query: str, script: str = "", options: Mapping[str, object] = {}) -> None:
        """Opens the player's page with `query`."""
        path = self.hosts.folder / "before.js"
        path.write_text(script, encoding="utf-8")
        url = f"{self.hosts.url}/player/watch.html?{query}"
        open_on(self.page, url, self.screen, [path], options)

    def reach(self, state: State) -> None:
        self.watch(state.query, state.script, state.options)
        self.do(*state.steps)

    def do(self, *steps: Step) -> None:
        for method, text in steps:
            getattr(self.page, method)(text.replace("SILENT_URL", self.hosts.silent_url))


def within(condition: str) -> Step:
    """Waits until the player is in this condition, and has its controls."""
    return "wait", f"part('.bar') && part('.frame').dataset.condition === '{condition}'"


def shows(part: str) -> Step:
    """Waits for a part that is loaded when it is first used, or shows after a while."""
    return "wait", f"part('{part}').checkVisibility({{ visibilityProperty: true }})"


def clicks(part: str) -> list[Step]:
    return [("wait", f"part('{part}')"), ("run", f"part('{part}').click()")]


START, AT_1, LIVE = "src=../static&autoplay=0", "src=../static&t=1", "src=../live&t=0"
POSTER = "element.poster = '../static/poster.jpg'; element.src = 'SILENT_URL'"
LOADING = [("wait", "player"), ("run", POSTER), within("loading"), shows(".spinner")]
PAUSED = [("wait", "player.shownFrame > 35"), ("run", "element.pause()"), within("paused")]
MENU = [*PAUSED, *clicks(".more"), shows(".menu")]
SCRUB = "part('.scrub').value = 90; part('.scrub').dispatchEvent(new Event('input'))"
FORCED, STILL = {"forcedColors": "active"}, {"reducedMotion": "reduce"}

STATES = {
    "start": State(START, [within("start")]),
    "loading": State(START, LOADING),
    "playing": State("src=../static&t=0.5", [within("playing")]),
    "still": State("src=../model", [within("still")]),
    "idle": State("src=../static", [("wait", "getComputedStyle(part('.bar')).opacity === '0'")]),
    "paused": State(AT_1, PAUSED),
    "ended": State("src=../static&loop=0&t=3.5", [within("ended")]),
    "waiting": State(LIVE, [within("waiting"), shows(".spinner")]),
    "stopped": State(LIVE, [("wait", "part('.note.soft').textContent.includes('has stopped')")]),
    "failed": State("src=../nothing", [within("failed")]),
    "failed-details": State("src=../nothing", [within("failed"), *clicks("summary")]),
    "no-webgl": State("src=../static", [within("failed")], NO_WEBGL),
    "context-lost": State(
        AT_1, [*PAUSED, ("run", "player.dispatchEvent(new Event('contextlost'))")]
    ),
    "menu": State(AT_1, MENU),
    "speed": State(AT_1, [*MENU, ("run", "(part('[data-name=rate]') ?? part('.rate')).click()")]),
    "keys": State(AT_1, [*PAUSED, ("press", "?"), shows("dialog")]),
    "statistics": State(AT_1, [*PAUSED, ("press", "i"), shows(".stats")]),
    "preview": State(AT_1, [*PAUSED, ("run", SCRUB), shows(".tile")]),
    "forced-colours": State(AT_1, PAUSED, options=FORCED),
    "forced-menu": State(AT_1, MENU, options=FORCED),
    "reduced-motion": State("src=../static&autoplay=1", [within("start")], options=STILL),
    "reduced-motion-loading": State(START, LOADING, options=STILL),
}
