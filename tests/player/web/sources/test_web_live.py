"""Live streams in the browser: joining, growth and end."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from urllib.request import Request, urlopen

import pytest

from codec.files import write_atomic
from codec.stream import StreamReader
from codec.stream.index import INDEX_NAME, record_bytes
from codec.tools.static import export_static
from tests.support.commands import ROOT
from tests.support.hosted_streams import served, static_host, write_stream
from tests.support.slots.slot_streams import write_busy_stream, write_slot_stream
from tests.support.slots.updates import small_layout
from tests.support.web.browsercode import BrowserCode
from tests.support.web.chromium import Page
from tests.support.web.publisher import Publisher

ELEMENT = "document.querySelector('swings-player')"
PLAYER = f"{ELEMENT}.player"
STATE = f"{PLAYER}.state"
BADGE = f"{ELEMENT}.shadowRoot.querySelector('.badge')"
NOTE = f"{ELEMENT}.shadowRoot.querySelector('.note.soft').textContent"
NUM_FRAMES = 300
SEGMENT_FRAMES = 15


@pytest.mark.parametrize(("fps", "segment_frames"), [(30, 15), (30, 1), (25, 50), (10, 200)])
def test_the_edge_is_a_segment_behind_what_comes_while_one_waits(
    browser: BrowserCode, fps: int, segment_frames: int
) -> None:
    lengths = list(range(1, 12 * segment_frames + 8 * fps, max(1, segment_frames // 7)))
    found = browser.ask("edges", fps=fps, segmentFrames=segment_frames, lengths=lengths)
    edges = [one["edge"] for one in found]
    assert edges == sorted(edges)
    for num_frames, one in zip(lengths, found, strict=True):
        edge, period_s = one["edge"], one["periodS"]
        assert period_s == min(5, max(0.5, segment_frames / fps))
        assert edge % segment_frames == 0
        lag = num_frames - edge
        # A segment exists once it is complete, is found up to a period later, and then fetched.
        needed = segment_frames + fps * period_s
        assert lag > needed if edge else lag <= needed + fps / 2 + segment_frames
        assert lag <= needed + fps / 2 + segment_frames
        assert one["behind"] == max(-1, edge - 3 * fps - 1)


def shown(browser: BrowserCode, speed: float, period_s: float, delay_s: float) -> list[dict]:  # type: ignore[type-arg]
    """Frames that a player shows, tick by tick, of a stream that grows at `speed` times its own
    rate and is polled every `period_s`; each segment takes `delay_s` to arrive."""
    fps, segment_frames, num_frames, joined_s = 30, 15, 300, 3.1

    def known(now_s: float) -> int:
        looked_s = (now_s - delay_s) // period_s * period_s
        made = int(looked_s * fps * speed + 1e-6) // segment_frames * segment_frames
        return max(0, min(made, num_frames))

    times_s = [joined_s + n / 61 for n in range(int(61 * (num_frames / fps / speed + 2)))]
    first = known(joined_s)
    question = {"fps": fps, "segmentFrames": segment_frames, "lengths": [first]}
    edge = browser.ask("edges", **question)[0]["edge"]
    events = [[t, known(t), known(t) < num_frames] for t in times_s]
    found: list[dict] = browser.ask(  # type: ignore[type-arg]
        "growing", fps=fps, numFrames=first, firstFrame=edge, events=events
    )
    frames = [one["frame"] for one in found if one["isNew"]]
    assert frames == list(range(edge, num_frames))
    assert all(one["frame"] < event[1] for one, event in zip(found, events, strict=True))
    assert found[-1]["hasEnded"]
    assert not found[-1]["waiting"]
    return found


@pytest.mark.parametrize("delay_s", [0.0, 0.2, 0.3])
def test_who_joins_at_the_edge_of_a_stream_made_in_its_own_time_never_waits(
    browser: BrowserCode, delay_s: float
) -> None:
    assert shown(browser, 1, 0.5, delay_s)[-1]["stalls"] == 0


def test_a_stream_made_slower_than_shown_is_waited_for_at_its_edge(browser: BrowserCode) -> None:
    found = shown(browser, 0.5, 0.5, 0.1)
    assert found[-1]["stalls"] > 3
    assert sum(one["waiting"] for one in found) > len(found) / 4


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished export of 10 s, in segments of half a second."""
    folder = tmp_path_factory.mktemp("live")
    layout = small_layout(1, (40, 20), 0, SEGMENT_FRAMES)
    write_busy_stream(folder / "stream", NUM_FRAMES, layout)
    export_static(folder / "stream", folder / "static")
    return folder / "static"


def served_bytes(url: str) -> int:
    with urlopen(Request(url, method="HEAD")) as response:
        return int(response.headers["Content-Length"])


@pytest.mark.parametrize("has_ranges", [False, True])
def test_the_index_is_followed_on_hosts_with_ranges_and_without(
    browser: BrowserCode, made: Path, tmp_path: Path, has_ranges: bool
) -> None:
    publisher = Publisher(made, tmp_path / "live")
    manifest = StreamReader(made).manifest
    size = record_bytes(manifest.num_layers)

    def follow(url: str) -> None:
        first = {"url": url, "manifest": manifest.to_json().hex()}
        assert browser.ask("refresh", **first) == {"fresh": [], "known": 0, "numBytes": 0}
        known = 0
        for count in (1, 0, 2, 1, 0, 5):
            publisher.publish(count)
            while served_bytes(url) < (known + count) * size:  # a server polls from time to time
                time.sleep(0.02)
            found = browser.ask("refresh")
            sent = count + 1 if has_ranges and known > 1 else known + count
            assert found["numBytes"] == sent * size
            assert found["fresh"] == list(range(known, known + count))
            known += count
            assert found["known"] == known

    if has_ranges:
        with served(tmp_path) as server:
            follow(f"{server.url}/v1/streams/live/{INDEX_NAME}")
    else:
        with static_host(tmp_path) as url:
            follow(f"{url}/live/{INDEX_NAME}")
            # A truncated index, and another stream's: known segments stay known.
            index = tmp_path / "live" / INDEX_NAME
            good = index.read_bytes()
            for bad in (good[: 3 * size], b"", (other(tmp_path) / INDEX_NAME).read_bytes()):
                write_atomic(index, bad)
                assert "another stream" in browser.ask("refresh")["failed"]
            write_atomic(index, good + good[:100])
            assert browser.ask("refresh")["fresh"] == []


def other(folder: Path) -> Path:
    """Another stream of the same shape."""
    layout = small_layout(1, (40, 20), 0, SEGMENT_FRAMES)
    write_slot_stream(folder / "other", 60, layout, seed=5)
    export_static(folder / "other", folder / "other static")
    return folder / "other static"


@pytest.fixture
def publisher(made: Path, tmp_path: Path) -> Publisher:
    (tmp_path / "web").symlink_to(ROOT / "player" / "web")
    return Publisher(made, tmp_path / "live")


@pytest.fixture
def url(publisher: Publisher, tmp_path: Path) -> Iterator[str]:
    with static_host(tmp_path) as host:
        yield f"{host}/web/watch.html?src=../live&loop=0"


def watch_frames(page: Page) -> None:
    """Records every shown frame from now on."""
    page.run(f"""
        const player = {PLAYER};
        window.frames_shown = [];
        const note = () => {{
            if (frames_shown.at(-1) !== player.shownFrame) frames_shown.push(player.shownFrame);
            requestAnimationFrame(note);
        }};
        note();
    """)


def test_a_stream_that_grows_plays_at_its_edge_until_it_ends(
    page: Page, publisher: Publisher, url: str, tmp_path: Path
) -> None:
    publisher.publish(8)
    page.open(url, 480, 320)
    page.wait(f"{PLAYER}?.shownFrame >= 0", 60)
    assert page.run(f"return {PLAYER}.shownFrame") >= 75  # 120 less 45
    watch_frames(page)
    page.wait(f"{BADGE}.classList.contains('on')")
    assert not page.run(f"return {BADGE}.classList.contains('behind')")
    with publisher.running(0.5):
        page.wait(f"{PLAYER}.shownFrame >= 135 && {PLAYER}.numFrames >= 180", 60)
        page.screenshot(tmp_path / "live.png")
        frames = page.run("return frames_shown")
        assert frames == sorted(frames)
        scrub = f"{ELEMENT}.shadowRoot.querySelector('.scrub')"
        page.wait(f"Number({scrub}.max) >= 179 && {scrub}.value >= 135")
        page.run(f"{ELEMENT}.focus()")
        page.click("swings-player canvas")
        for way in ("badge", "key"):
            if page.run(f"return {STATE}.playing"):
                page.press("k")
            page.press("Home")
            page.wait(f"{PLAYER}.shownFrame === 0 && {BADGE}.classList.contains('behind')", 30)
            page.screenshot(tmp_path / "behind.png")
            if way == "badge":
                page.click("swings-player .badge")
            else:
                page.press("End")
            page.wait(f"{PLAYER}.shownFrame >= 135 && {STATE}.playing", 30)
            page.wait(f"!{BADGE}.classList.contains('behind')")
        watch_frames(page)
    publisher.finish()
    page.run(f"{PLAYER}.setRate(4)")
    page.wait(f"!{PLAYER}.live && !{BADGE}.classList.contains('on')", 30)
    page.wait(f"{PLAYER}.shownFrame === {NUM_FRAMES - 1} && !{STATE}.playing", 60)
    frames = page.run("return frames_shown")
    assert frames == sorted(frames)
    assert not page.complaints


def test_a_stream_is_waited_for_before_it_begins_and_while_there_is_no_network(
    page: Page, publisher: Publisher, url: str
) -> None:
    page.open(url, 320, 240)
    page.wait(f"({NOTE} ?? '').includes('has no frames yet')", 30)
    publisher.publish(3)
    page.wait(f"{PLAYER}.shownFrame >= 0 && {NOTE} === ''", 60)
    watch_frames(page)
    page.set_offline(True)
    publisher.publish(4)
    # It shows the data that it had, and waits.
    page.wait(f"{STATE}.waiting && {NOTE}.includes('trying again')", 30)
    assert page.run(f"return {PLAYER}.numFrames") == 45
    page.set_offline(False)
    page.wait(f"{PLAYER}.numFrames === 105 && {PLAYER}.shownFrame > 60 && {NOTE} === ''", 30)
    page.set_offline(True)
    publisher.finish()
    page.set_offline(False)
    page.wait(f"!{PLAYER}.live && {PLAYER}.numFrames === {NUM_FRAMES}", 30)
    page.wait(f"{PLAYER}.shownFrame > 110", 30)
    frames = page.run("return frames_shown")
    assert frames == sorted(frames)


@pytest.mark.parametrize(("query", "first"), [("&t=1", 30), ("&t=0", 0)])
def test_a_start_that_is_asked_for_is_where_it_starts(
    page: Page, publisher: Publisher, url: str, query: str, first: int
) -> None:
    publisher.publish(12)
    page.open(f"{url}&autoplay=0{query}", 320, 240)
    page.wait(f"{PLAYER}?.shownFrame === {first}", 60)
    page.wait(f"{BADGE}.classList.contains('behind')" if first == 0 else f"{BADGE}.matches('.on')")


@pytest.mark.slow
def test_a_stream_of_version_1_grows_too(page: Page, tmp_path: Path) -> None:
    write_stream(tmp_path / "stream", 40)
    export_static(tmp_path / "stream", tmp_path / "static")
    (tmp_path / "web").symlink_to(ROOT / "player" / "web")
    publisher = Publisher(tmp_path / "static", tmp_path / "live")
    publisher.publish(2)
    with static_host(tmp_path) as host:
        page.open(f"{host}/web/watch.html?src=../live&loop=0", 320, 240)
        page.wait(f"{PLAYER}?.shownFrame === 9 && {STATE}.waiting", 60)
        publisher.publish(3)
        page.wait(f"{PLAYER}.shownFrame === 24 && {STATE}.waiting", 30)
        publisher.finish()
        page.wait(f"{PLAYER}.shownFrame === 39 && !{STATE}.playing", 30)
