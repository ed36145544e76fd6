"""The host that tests of pages share: the player as it ships, its sources, and small streams."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from codec.stream.reader import StreamReader
from codec.tools.static import export_static
from tests.support.hosted_streams import static_host, write_stream
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout
from tests.support.web.canvas import PIXELS
from tests.support.web.chromium import Page
from tests.support.web.nodeprocess import PACKAGES, WEB

LINKS = {"player": WEB / "bundle", "web": WEB, "npm": PACKAGES}
"""Folders of a host: the bundle, which is what viewers get; the single modules, for tests that
reach inside of one; and packages of others."""

CLIP_FRAMES, LONG_FRAMES, WHOLE_FRAMES = 45, 600, 60
SEGMENT_FRAMES = 15
NUM_LAYERS = 3
SLOW_DOWN = "(element.playbackRate = 0.25)"
"""Part of a wait: what the player has lasts, however late the test takes its next step."""


def write_streams(folder: Path) -> None:
    """Streams at 30 frames a second, and their static exports: "clip" of 1.5 s and "long" of 20 s
    with slots that last; "whole" of 2 s with whole slices and colours of degree 1 in one layer."""
    for name, num_frames, slots in (
        ("clip", CLIP_FRAMES, (40, 30, 20)),
        ("long", LONG_FRAMES, (20, 20, 10)),
    ):
        layout = small_layout(1, slots, 0, SEGMENT_FRAMES)
        write_busy_stream(folder / "trained" / name, num_frames, layout)
    write_stream(folder / "trained" / "whole", WHOLE_FRAMES, 100, layers=(1.0,))
    for path in (folder / "trained").iterdir():
        export_static(path, folder / path.name)


@contextlib.contextmanager
def player_host(folder: Path, cors: bool = False) -> Iterator[str]:
    """Serves the files of `folder`, to which it adds LINKS; gives the host's URL."""
    for name, target in LINKS.items():
        if not (folder / name).exists():
            (folder / name).symlink_to(target)
    with static_host(folder, cors=cors) as url:
        yield url


def watch(
    page: Page,
    address: str,
    width_px: int = 160,
    height_px: int = 120,
    scripts: tuple[Path, ...] = (),
    **more: object,
) -> None:
    """Opens a page with a player, and waits for its first frame and its controls. more: arguments
    of `Page.open`."""
    page.open(address, width_px, height_px, scripts=(*scripts, PIXELS), **more)  # type: ignore[arg-type]
    page.wait("player.shownFrame >= 0 && part('.bar')")


@dataclass(frozen=True, slots=True)
class Site:
    """A host of the streams of `write_streams`, in a folder that one test process may write to."""

    url: str
    folder: Path

    def address(self, stream: str, query: str = "autoplay=0") -> str:
        return f"{self.url}/player/watch.html?src=../{stream}&{query}"

    def watch(
        self,
        page: Page,
        stream: str,
        query: str = "autoplay=0",
        size_px: tuple[int, int] = (160, 120),
        **more: object,
    ) -> None:
        watch(page, self.address(stream, query), *size_px, **more)  # type: ignore[arg-type]

    def reader(self, stream: str) -> StreamReader:
        return StreamReader(self.folder / "trained" / stream)

    def write_page(self, name: str, html: str) -> str:
        """Adds a page; returns its URL."""
        head = '<!doctype html><link rel="icon" href="data:," />'
        (self.folder / name).write_text(head + html, encoding="utf-8")
        return f"{self.url}/{name}"
