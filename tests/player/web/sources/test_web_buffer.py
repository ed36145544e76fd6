"""Received data stays: loops, seeks and scrubbing read it from the browser player's buffer."""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.request import urlopen

import pytest

from codec.stream.playrecord import RecordParser, encode_record
from codec.tools.static import export_static
from tests.support.commands import ROOT
from tests.support.hosted_streams import served, static_host, wait_for_stream
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout
from tests.support.web.canvas import ELEMENT, PLAYER, STATE
from tests.support.web.chromium import Page

NUM_FRAMES = 45
LONG_FRAMES = 150
SEGMENT_FRAMES = 15
NUM_LAYERS = 3
HOSTS = ["static", "server"]

LOOP = """
const { player } = document.querySelector("swings-player");
let [rounds, last] = [0, player.state.frame];
await new Promise((resolve) => {
  const look = () => {
    rounds += player.state.frame < last ? 1 : 0;
    last = player.state.frame;
    if (rounds < value) return;
    player.removeEventListener("state", look);
    resolve();
  };
  player.addEventListener("state", look);
});
return player.state.receivedBytes;
"""
"""Waits for the end of `value` more rounds; returns the bytes received by then."""

SEEK = """
const player = document.querySelector("swings-player").player;
for (const frame of value) player.seek(frame);
const whole = () => player.shownFrame === value.at(-1) && !player.isSeeking;
await new Promise((resolve, reject) => {
  const endMs = performance.now() + 60000;
  const look = () => {
    if (whole() && player.state.frame === value.at(-1) && player.state.layers === 3) resolve();
    else if (performance.now() > endMs) reject(new Error(JSON.stringify(player.state)));
    else setTimeout(look, 10);
  };
  look();
});
return player.state.receivedBytes;
"""
"""Seeks one after another without waiting; returns once the last one shows with all layers."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A stream of 1.5 s, its static export, and the page."""
    return write_folder(tmp_path_factory.mktemp("buffer"), NUM_FRAMES)


@pytest.fixture(scope="module")
def long_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Like `folder`, with a stream of ten segments."""
    return write_folder(tmp_path_factory.mktemp("long"), LONG_FRAMES)


def write_folder(folder: Path, num_frames: int) -> Path:
    layout = small_layout(1, (200, 200, 100), 0, SEGMENT_FRAMES)
    write_busy_stream(folder / "stream", num_frames, layout)
    export_static(folder / "stream", folder / "static")
    (folder / "web").symlink_to(ROOT / "player" / "web")
    return folder


@contextmanager
def hosted(folder: Path, kind: str) -> Iterator[str]:
    """Serves the folder; gives the URL of the stream's page."""
    if kind == "static":
        with static_host(folder) as url:
            yield f"{url}/web/watch.html?src=../static"
    else:
        with served(folder) as server:
            yield f"{server.url}/watch/stream?"


def opened(page: Page, url: str) -> None:
    page.open(f"{url}&autoplay=0", 160, 120)
    page.wait(f"{PLAYER}?.shownFrame >= 0", 60)


@pytest.mark.parametrize("kind", HOSTS)
def test_a_loop_is_received_once_and_goes_on_without_its_host(
    page: Page, folder: Path, kind: str
) -> None:
    with hosted(folder, kind) as url:
        opened(page, f"{url}&loop=1")
        page.run(f"{PLAYER}.setPlaying(true)")
        first = page.run(LOOP, 1)
        page.run(f"window.waits = 0; {ELEMENT}.addEventListener('waiting', () => waits++)")
        page.run(f"{PLAYER}.setRate(3)")
        assert page.run(LOOP, 17) - first < 0.02 * first
    page.run(LOOP, 2)
    assert page.run(f"return [waits, {STATE}.stalls, {STATE}.layers]") == [0, 0, NUM_LAYERS]
    assert page.run(f"return {STATE}.bufferedRanges") == [[0, NUM_FRAMES]]
    assert not [line for line in page.complaints if "ERR_CONNECTION_REFUSED" not in line]


@pytest.mark.parametrize("kind", HOSTS)
def test_a_hundred_paused_seeks_all_show_all_layers(
    page: Page, long_folder: Path, kind: str
) -> None:
    """The buffer keeps only the shown and the next segment, so that most seeks fetch again."""
    rng = random.Random(kind)
    with hosted(long_folder, kind) as url:
        opened(page, f"{url}&buffer-mb=0.001")
        received = page.run(f"return {STATE}.receivedBytes")
        left = 100
        while left > 0:
            count = min(left, rng.choice((1, 1, 2, 7)))
            before = received
            received = page.run(SEEK, [rng.randrange(LONG_FRAMES) for _ in range(count)])
            left -= count
        assert received > before, "the last seek was received too, or all was kept"
        assert not page.complaints


def test_layers_of_a_still_picture_are_read_behind_all_that_shows_later(
    page: Page, long_folder: Path, tmp_path: Path
) -> None:
    """A server may send them in any order, and the buffer cannot hold that much of layer 0."""
    parser = RecordParser()
    with served(long_folder) as server:
        wait_for_stream(server, "stream")
        url = f"{server.url}/v1/streams/stream/play?plain=1&until={LONG_FRAMES // 2}"
        with urlopen(url) as response:
            start, *records, end = parser.feed(response.read())
    records.sort(key=lambda record: getattr(record, "first_layer", 0) > 0)
    plays = tmp_path / "v1" / "streams" / "any"
    plays.mkdir(parents=True)
    (plays / "play").write_bytes(b"".join(map(encode_record, (start, *records, end))))
    (tmp_path / "web").symlink_to(ROOT / "player" / "web")
    with static_host(tmp_path) as url:
        opened(page, f"{url}/web/watch.html?src=/v1/streams/any&buffer-mb=0.001")
        page.wait(f"{STATE}.layers === {NUM_LAYERS}")


@pytest.mark.parametrize("kind", HOSTS)
def test_the_picture_follows_the_thumb(page: Page, folder: Path, kind: str) -> None:
    with hosted(folder, kind) as url:
        opened(page, f"{url}&buffer-mb=0.001")
        for frame, picture in ((29, 30), (18, 15), (44, 30)):
            page.run(f"{PLAYER}.scrub({frame})")
            page.wait(f"{PLAYER}.shownFrame === {picture}")
        page.run(SEEK, [22])
