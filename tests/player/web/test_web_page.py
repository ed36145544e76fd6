"""The page plays a stream from a plain file server as expected."""

from __future__ import annotations

import random
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from codec.tools.static import export_static
from tests.support.hosted_streams import static_host
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout
from tests.support.web.chromium import Page

ROOT = Path(__file__).parents[3]
NUM_FRAMES = 60
STATE = "document.querySelector('swings-player').player.state"
PLAYER = "document.querySelector('swings-player').player"


def note(selector: str) -> str:
    """The expression for the text of a note on the page."""
    root = "document.querySelector('swings-player').shadowRoot"
    return f"{root}.querySelector('{selector}').textContent"


@pytest.fixture
def watched(page: Page, tmp_path: Path) -> Iterator[Page]:
    """The page, paused at the first frame."""
    layout = small_layout(1, (400, 300, 300), 0, 15)
    write_busy_stream(tmp_path / "stream", NUM_FRAMES, layout)
    export_static(tmp_path / "stream", tmp_path / "static")
    (tmp_path / "web").symlink_to(ROOT / "player" / "web")
    with static_host(tmp_path) as url:
        page.open(f"{url}/web/watch.html?src=../static&autoplay=0", 480, 320)
        page.wait(f"{PLAYER}?.shownFrame >= 0", 60)
        yield page
        assert not page.complaints


def test_it_plays_pauses_seeks_and_ends(watched: Page, tmp_path: Path) -> None:
    assert watched.run(f"return {STATE}.playing") is False
    watched.run("document.querySelector('swings-player').focus()")
    watched.click("swings-player .play")
    watched.wait(f"{STATE}.frame >= 5", 60)
    watched.press("k")
    watched.wait(f"{STATE}.playing === false")
    watched.press("Home")
    watched.wait(f"{PLAYER}.shownFrame === 0", 30)
    watched.press("ArrowRight")  # a tenth of this short clip
    watched.wait(f"{PLAYER}.shownFrame === 6", 30)
    watched.screenshot(tmp_path / "page.png")
    watched.press("o")
    watched.press("End")
    watched.wait(f"{PLAYER}.shownFrame === {NUM_FRAMES - 1}", 30)
    watched.press("k")
    watched.wait(f"{PLAYER}.shownFrame < 30 && {STATE}.playing", 30)


def test_keys_work_before_anything_is_clicked(watched: Page) -> None:
    root = "document.querySelector('swings-player').shadowRoot"
    watched.press("i")
    watched.wait(f"{root}.querySelector('.stats')?.hidden === false")
    watched.press("Space")
    watched.wait(f"{STATE}.playing")
    watched.press("Space")
    watched.wait(f"!{STATE}.playing")
    watched.press("Tab")
    watched.wait(f"{root}.activeElement.className === 'scrub'")


@pytest.fixture(scope="module")
def long_stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the page and a stream of 20 s."""
    tmp_path = tmp_path_factory.mktemp("long")
    layout = small_layout(1, (20, 20, 10), 0, 15)
    write_busy_stream(tmp_path / "stream", 600, layout)
    export_static(tmp_path / "stream", tmp_path / "static")
    (tmp_path / "web").symlink_to(ROOT / "player" / "web")
    return tmp_path


def test_three_seconds_without_a_network(page: Page, long_stream: Path) -> None:
    with static_host(long_stream) as url:
        page.open(f"{url}/web/watch.html?src=../static", 320, 240)
        page.wait(f"{STATE}?.endFrame - {STATE}.frame > 150", 60)
        page.set_offline(True)
        frame, stalls = page.run(f"return [{STATE}.frame, {STATE}.stalls]")
        time.sleep(3)
        page.set_offline(False)
        page.wait(f"{STATE}.frame > {frame + 60}")
        page.wait(f"{STATE}.endFrame - {STATE}.frame > 150")
        assert page.run(f"return {STATE}.stalls") == stalls


def test_a_host_that_is_gone_for_a_while_and_a_stream_that_is_not_there(
    page: Page, long_stream: Path
) -> None:
    with static_host(long_stream) as url:
        page.open(f"{url}/web/watch.html?src=../static", 320, 240)
        page.wait(f"{STATE}?.endFrame > 60", 60)
    page.wait(f"{note('.note.soft')}.includes('trying again')", 30)
    with static_host(long_stream, int(url.rpartition(":")[2])):
        page.wait(f"{note('.note.soft')} === ''", 30)
        end = page.run(f"return {STATE}.endFrame")
        page.wait(f"{STATE}.endFrame > {end + 30}", 30)
        page.run("document.querySelector('swings-player').setAttribute('src', '../nothing')")
        page.wait(f"{note('.note:not(.soft)')}.includes('HTTP 404')", 30)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("manifest.json", "flipped"),
        ("index.bin", "random"),
        ("segments/0/masks", "flipped"),
        ("segments/0/0", "random"),
        ("segments/0/1", "flipped"),
        ("segments/0/snapshot-0", "cut"),
    ],
)
def test_a_file_that_was_altered(page: Page, long_stream: Path, name: str, kind: str) -> None:
    """The page reports the error, or plays without the file; it neither breaks nor hangs."""
    rng = random.Random(name + kind)
    folder = long_stream / f"altered-{kind}"
    if not folder.exists():
        shutil.copytree(long_stream / "static", folder)
    file = folder / name
    good = file.read_bytes()
    altered = bytearray(good)
    if kind == "flipped":
        for _ in range(12):
            altered[rng.randrange(len(altered))] ^= 1 << rng.randrange(8)
    elif kind == "cut":
        del altered[len(altered) // 2 :]
    else:
        altered[40:] = rng.randbytes(len(altered) - 40)
    file.write_bytes(altered)
    try:
        with static_host(long_stream) as url:
            page.open(f"{url}/web/watch.html?src=../{folder.name}", 320, 240)
            says = f"{note('.note:not(.soft)')} !== ''"
            page.wait(f"{says} || {STATE}?.frame > 20", 30)
            text = page.run(f"return {note('.note:not(.soft)')}")
            assert "player failed" not in text
            assert not page.complaints
    finally:
        file.write_bytes(good)
