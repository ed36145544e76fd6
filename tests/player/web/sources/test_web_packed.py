"""The browser player reads a packed stream by ranges of the one file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image

from codec.errors import CodecError
from codec.stream import StreamReader
from codec.stream.captions import Captions
from codec.stream.streampacker import pack_stream
from codec.tools.static import export_static
from codec.tracks.streamtracks import add_captions
from tests.support.delivery.rangehost import RangeHost, range_host
from tests.support.hosted_streams import static_host, write_stream
from tests.support.sounding import add_clicks
from tests.support.tiny_stream import files_of
from tests.support.web.browsercode import BrowserCode
from tests.support.web.chromium import Page
from tests.support.web.nodeprocess import SCRIPTS
from tests.support.web.site import LINKS, watch

TAP = SCRIPTS / "soundtap.js"
NUM_FRAMES = 30


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("host")
    trained = write_stream(root / "trained", NUM_FRAMES)
    manifest = replace(StreamReader(trained).manifest, poster="poster.png", storyboard="tiles.png")
    (trained / "manifest.json").write_bytes(manifest.to_json())
    for name, width_px in (("poster.png", 64), ("tiles.png", 128)):
        Image.new("RGB", (width_px, 48), (200, 40, 40)).save(trained / name)
    add_clicks(trained, (0, 7, 20))
    add_clicks(trained, (9,), "voice", ((0.0, 1.0, 2.0, 3.0),))
    (root / "in.vtt").write_text("WEBVTT\n\n00:00.000 --> 01:00.000\nHere\n")
    add_captions(trained, root / "in.vtt", Captions("en", "English"))
    export_static(trained, root / "folder")
    pack_stream(trained, root / "packed.swings")
    (root / "player").symlink_to(LINKS["player"])
    return root


def test_a_static_export_to_one_file_is_its_folder(root: Path, tmp_path: Path) -> None:
    pack_stream(root / "folder", tmp_path / "again.swings")
    assert (tmp_path / "again.swings").read_bytes() == (root / "packed.swings").read_bytes()
    assert [path.name for path in root.iterdir() if path.name.startswith(".")] == []


def test_every_object_of_it_comes_as_it_is(browser: BrowserCode, root: Path) -> None:
    with range_host(root) as host:
        got = browser.ask("allObjects", url=f"{host.url}/packed.swings")
        files = {path: data.hex() for path, data in files_of(root / "folder").items()}
        assert got["found"] | got["files"] == {
            path: data for path, data in files.items() if path not in ("manifest.json", "index.bin")
        }
        assert not got["found"].keys() & got["files"].keys()
        assert all(asked.startswith("bytes=") for _, asked in host.asked)
        assert len(host.asked) == 1 + len(got["found"]) + len(got["files"])


def complaint(browser: BrowserCode, url: str) -> str:
    """The error of reading the stream at `url`; empty if there is none."""
    try:
        return str(browser.ask("allObjects", url=url).get("failed", ""))
    except CodecError as error:
        return str(error)


def test_hosts_and_files_that_will_not_do_are_said(browser: BrowserCode, root: Path) -> None:
    whole = (root / "packed.swings").read_bytes()
    with static_host(root) as plain:
        failed = browser.ask("allObjects", url=f"{plain}/packed.swings")["failed"]
        assert "does not send parts of a file" in failed
    bad = root / "bad.swings"
    with range_host(root) as host:
        for data in (
            b"",
            b"PK",
            b"<html>" + bytes(90),
            whole[:500],
            whole[: len(whole) // 2],
            whole[:51] + b"\xff\xff\xff\x0f" + whole[55:],  # the index
            whole[:55] + b"\xff\xff\xff\x0f" + whole[59:],  # the poster
            whole[:18] + b"\xff\xff\x0f\0" * 2 + whole[26:],  # the manifest
            whole[:48] + b"\1" + whole[49:],
            whole[:63] + b"\xff\xff\xff\x0f" + whole[67:],  # the table of sound and captions
            whole[:63] + bytes(4) + whole[67:],  # without the table
            whole[:47] + b"\2" + whole[48:],  # another layout
        ):
            bad.write_bytes(data)
            said = complaint(browser, f"{host.url}/bad.swings")
            assert said, data[:70]
            assert "\n" not in said
    bad.unlink()


def requests_of(page: Page, host: RangeHost, name: str) -> int:
    """Opens the page; returns the number of requests for the stream until all of it is there."""
    host.asked.clear()
    watch(page, f"{host.url}/player/watch.html?src=../{name}&autoplay=0&loop=0")
    page.wait(f"state.endFrame === {NUM_FRAMES}")
    page.wait_until_still("state.receivedBytes")
    return sum(1 for path, _ in host.asked if path.startswith(f"/{name}"))


def test_a_page_plays_it_and_seeks_in_it_like_in_a_folder(page: Page, root: Path) -> None:
    with range_host(root) as host:
        folder = requests_of(page, host, "folder")
        packed = requests_of(page, host, "packed.swings")
        assert packed <= folder + 2, (packed, folder)
        page.wait("part('.poster').naturalWidth === 64")
        page.run(f"element.currentTime = {NUM_FRAMES // 2} / 30")
        page.wait(f"player.shownFrame === {NUM_FRAMES // 2}")
        page.run("element.play()")
        page.wait(f"player.shownFrame === {NUM_FRAMES - 1}")
        assert page.value("element.error") is None


def test_a_page_plays_its_sound_and_shows_its_captions(page: Page, root: Path) -> None:
    with range_host(root) as host:
        watch(page, f"{host.url}/player/watch.html?src=../packed.swings", scripts=(TAP,))
        page.wait("clicks.length >= 4")
        page.run("element.focus()")
        page.press("c")
        page.wait("part('.captions').textContent === 'Here'")
        ours = [asked for path, asked in host.asked if path.startswith("/packed")]
        assert ours
        assert all(ours)


FEED = """const { GaussianFeed } = await import('./gaussianfeed.js');
const feed = new GaussianFeed(value);
feed.play();
for (; feed.frame < 9; feed.take()) await new Promise(requestAnimationFrame);
return feed.gaussians.opacities.some((one) => one > 0)"""


def test_a_page_of_another_origin_plays_it_and_a_feed(page: Page, root: Path) -> None:
    """A range needs no permission of its own, and the size of the file stays hidden."""
    with range_host(root) as host, range_host(root) as other:
        other.cors = True
        src = f"{other.url}/packed.swings"
        watch(page, f"{host.url}/player/watch.html?src={src}&autoplay=0")
        assert len(other.asked) > 3
        assert page.run(FEED, src) is True
