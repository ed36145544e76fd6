"""Heaps of a page and its workers while a stream keeps playing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from codec.tools.static import export_static
from tests.support.commands import ROOT
from tests.support.hosted_streams import static_host
from tests.support.web.canvas import PLAYER
from tests.support.web.chromium import Page

PLAY_UNTIL = """
const { player } = document.querySelector("swings-player");
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
    (folder / "web").symlink_to(ROOT / "player" / "web")
    with static_host(folder) as url:
        page.open(f"{url}/web/watch.html?src=../static&autoplay=0&buffer-mb={buffer_mb}", 160, 120)
        page.wait(f"{PLAYER}?.shownFrame >= 0", 60)
        page.run(f"{PLAYER}.setRate({rate})")
        yield page
        assert not page.complaints
