"""Received data stays: loops, seeks and scrubbing read it from the browser player's buffer."""

from __future__ import annotations

import random
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.request import urlopen

import pytest

from codec.stream.playrecord import RecordParser, encode_record
from tests.support.hosted_streams import ServerProcess, served
from tests.support.web.chromium import Page
from tests.support.web.site import (
    CLIP_FRAMES,
    LONG_FRAMES,
    NUM_LAYERS,
    SLOW_DOWN,
    Site,
    player_host,
    watch,
)

HOSTS = ["static", "server"]

LOOP = """
let [rounds, last] = [0, state.frame];
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
for (const frame of value) player.seek(frame);
const whole = () => player.shownFrame === value.at(-1) && !player.isSeeking;
await new Promise((resolve) => {
  const look = () => {
    if (whole() && player.state.frame === value.at(-1) && player.state.layers === 3) resolve();
    else setTimeout(look, 10);
  };
  look();
});
return player.state.receivedBytes;
"""
"""Seeks one after another without waiting; returns once the last one shows with all layers."""


def address(site: Site, server: ServerProcess, kind: str, stream: str, query: str) -> str:
    if kind == "static":
        return site.address(stream, query)
    return f"{server.url}/watch/{stream}?{query}"


@contextmanager
def host_of_its_own(site: Site, folder: Path, kind: str) -> Iterator[str]:
    """Gives the page of the clip."""
    if kind == "static":
        (folder / "clip").symlink_to(site.folder / "clip")
        with player_host(folder) as url:
            yield f"{url}/player/watch.html?src=../clip&"
    else:
        shutil.copytree(site.folder / "trained" / "clip", folder / "clip")
        with served(folder) as server:
            yield f"{server.url}/watch/clip?"


@pytest.mark.parametrize("kind", HOSTS)
def test_a_loop_is_received_once_and_goes_on_without_its_host(
    page: Page, site: Site, tmp_path: Path, kind: str
) -> None:
    page.expect("ERR_CONNECTION_REFUSED", "ERR_EMPTY_RESPONSE", "ERR_CONNECTION_RESET")
    with host_of_its_own(site, tmp_path, kind) as url:
        watch(page, f"{url}autoplay=0&loop=1")
        page.run("player.setPlaying(true)")
        first = page.run(LOOP, 1)
        page.run("player.setRate(3)")
        assert page.run(LOOP, 4) - first < 0.02 * first
    page.run(LOOP, 2)
    whole = f"JSON.stringify(state.bufferedRanges) === '[[0,{CLIP_FRAMES}]]'"
    page.wait(f"state.layers === {NUM_LAYERS} && {whole}")  # a loop begins with none for a moment


PLAY_ON = """
const { stalls, frame } = state;
await new Promise((resolve) => {
  player.addEventListener("state", () => player.state.frame >= frame + value && resolve());
});
return player.state.stalls - stalls;
"""
"""Plays `value` more frames; returns the number of stalls in the meantime."""


@pytest.mark.parametrize("kind", HOSTS)
def test_while_there_is_no_network_it_plays_what_it_has(
    page: Page, site: Site, server: ServerProcess, kind: str
) -> None:
    page.expect("ERR_INTERNET_DISCONNECTED")
    watch(page, address(site, server, kind, "long", ""))
    page.wait(f"state.endFrame - state.frame > 150 && {SLOW_DOWN}")
    page.set_offline(True)
    end = page.value("state.endFrame")
    assert page.run(PLAY_ON, 30) == 0
    note = "part('.note.soft').textContent"
    page.run("element.playbackRate = 4")
    if kind == "static":  # the body of a play that has begun may still come
        page.wait(f"{note}.includes('trying again')")
    page.set_offline(False)
    page.wait(f"state.endFrame > {end + 15} && {note} === ''")


@pytest.mark.realtime
@pytest.mark.parametrize("kind", HOSTS)
def test_a_loop_never_waits(page: Page, site: Site, server: ServerProcess, kind: str) -> None:
    watch(page, address(site, server, kind, "clip", "loop=1"))
    page.run(LOOP, 1)
    stalls = page.value("state.stalls")
    page.run("window.waits = 0; element.addEventListener('waiting', () => waits++)")
    page.run("player.setRate(3)")
    page.run(LOOP, 17)
    assert page.value("[waits, state.stalls]") == [0, stalls]


@pytest.mark.parametrize("kind", HOSTS)
@pytest.mark.parametrize("count", [12, pytest.param(100, marks=pytest.mark.deep)])
def test_many_paused_seeks_all_show_all_layers(
    page: Page, site: Site, server: ServerProcess, kind: str, count: int
) -> None:
    """The buffer keeps only the shown and the next segment, so that most seeks fetch again."""
    rng = random.Random(kind)
    watch(page, address(site, server, kind, "long", "autoplay=0&buffer-mb=0.001"))
    while count > 0:
        at_once = min(count, rng.choice((1, 1, 2, 7)))
        page.run(SEEK, [rng.randrange(LONG_FRAMES) for _ in range(at_once)])
        count -= at_once
    received = page.run(SEEK, [0])
    assert page.run(SEEK, [LONG_FRAMES // 2]) > received, "not all was kept"


def test_layers_of_a_still_picture_are_read_behind_all_that_shows_later(
    page: Page, server: ServerProcess, tmp_path: Path
) -> None:
    """A server may send them in any order, and the buffer cannot hold that much of layer 0."""
    parser = RecordParser()
    with urlopen(f"{server.url}/v1/streams/long/play?until=75") as response:
        start, *records, end = parser.feed(response.read())
    records.sort(key=lambda record: getattr(record, "first_layer", 0) > 0)
    plays = tmp_path / "v1" / "streams" / "any"
    plays.mkdir(parents=True)
    (plays / "play").write_bytes(b"".join(map(encode_record, (start, *records, end))))
    with player_host(tmp_path) as url:
        query = "src=/v1/streams/any&autoplay=0&buffer-mb=0.001"
        watch(page, f"{url}/player/watch.html?{query}")
        page.wait(f"state.layers === {NUM_LAYERS}")


@pytest.mark.parametrize("kind", HOSTS)
def test_the_picture_follows_the_thumb(
    page: Page, site: Site, server: ServerProcess, kind: str
) -> None:
    watch(page, address(site, server, kind, "clip", "autoplay=0&buffer-mb=0.001"))
    for frame, picture in ((29, 30), (18, 15), (44, 30)):
        page.run("player.scrub(value)", frame)
        page.wait(f"player.shownFrame === {picture}")
    page.run(SEEK, [22])
