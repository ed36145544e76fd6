"""Heaps of a page and its workers while a stream keeps playing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from codec.tools.static import export_static
from tests.support.web.chromium import Page
from tests.support.web.site import player_host, watch

PLAY_UNTIL = """
let [played, last] = [window.played ?? 0, player.state.frame];
await new Promise((resolve) => {
  const look = () => {
    const { frame } = player.state;
    played += frame - last + (frame < last ? player.numFrames : 0);
    last = frame;
    if (played < value) return;
    player.removeEventListener("state", look);
    resolve();
  };
  player.addEventListener("state", look);
  player.setPlaying(true);
});
window.played = played;
player.setPlaying(false);
return played;
"""
"""Plays until `value` frames have been played in total; returns the number of played frames."""


@contextmanager
def opened(page: Page, folder: Path, rate: float, buffer_mb: float) -> Iterator[Page]:
    """Opens the page, paused at the first frame of the stream in `folder`."""
    export_static(folder / "stream", folder / "static")
    with player_host(folder) as url:
        page.close()  # a process of its own
        query = f"src=../static&autoplay=0&buffer-mb={buffer_mb}"
        watch(page, f"{url}/player/watch.html?{query}")
        page.run("player.setRate(value)", rate)
        yield page
