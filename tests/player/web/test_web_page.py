"""The page of a stream on a plain file server: its poster, and files and hosts that fail."""

from __future__ import annotations

import random
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image

from codec.files import write_atomic
from codec.stream import StreamReader
from codec.tools.static import export_static
from tests.support.hosted_streams import static_host, write_stream
from tests.support.web import nodeprocess
from tests.support.web.chromium import Page
from tests.support.web.site import LONG_FRAMES, SLOW_DOWN, Site, player_host, watch

NOTE = "part('.note:not(.soft)').textContent"
SOFT_NOTE = "part('.note.soft').textContent"
POSTER = "art/still #1.jpg"


def test_a_host_that_is_gone_for_a_while_and_a_stream_that_is_not_there(
    page: Page, site: Site, tmp_path: Path
) -> None:
    page.expect("404", "ERR_CONNECTION_REFUSED", "ERR_CONNECTION_RESET", "ERR_EMPTY_RESPONSE")
    (tmp_path / "long").symlink_to(site.folder / "long")
    with player_host(tmp_path) as url:
        watch(page, f"{url}/player/watch.html?src=../long")
        page.wait(f"state.endFrame > 60 && {SLOW_DOWN}")
        page.run("player.addEventListener('trouble', ({ detail }) => (window.trouble = detail))")
    page.wait("window.trouble?.includes('trying again') && !state.waiting")
    assert page.value(SOFT_NOTE) == "", "it is said once it hurts"
    page.run("element.currentTime = 19.9")
    page.wait(f"{SOFT_NOTE}.includes('trying again')")
    with static_host(tmp_path, int(url.rpartition(":")[2])):
        page.wait(f"{SOFT_NOTE} === ''")
        page.wait("player.shownFrame >= 590")
        page.run("element.setAttribute('src', '../nothing')")
        page.wait(f"{NOTE}.includes('HTTP 404')")


def test_a_poster_shows_until_the_first_frame_and_may_be_missing(
    page: Page, tmp_path: Path
) -> None:
    stream = write_stream(tmp_path / "stream", 10)
    manifest = replace(StreamReader(stream).manifest, poster=POSTER)
    write_atomic(stream / "manifest.json", manifest.to_json())
    (stream / POSTER).parent.mkdir()
    Image.new("RGB", (64, 48), (200, 40, 40)).save(stream / POSTER)
    export_static(stream, tmp_path / "good")
    for name, missing in (("unplayable", "segments"), ("bare", "art")):
        shutil.copytree(tmp_path / "good", tmp_path / name)
        shutil.rmtree(tmp_path / name / missing)
    page.expect("404")
    opacity = "getComputedStyle(part('.poster')).opacity"
    with player_host(tmp_path) as url:
        address = f"{url}/player/watch.html?autoplay=0&src=.."
        page.open(f"{address}/unplayable")
        page.wait("part('.poster').naturalWidth === 64")
        assert page.value(f"part('.poster').checkVisibility() && {opacity}") == "1"
        watch(page, f"{address}/good")
        page.wait(f"{opacity} === '0'")
        assert page.value("part('.poster').naturalWidth") == 64
        watch(page, f"{address}/bare")
        page.wait("part('.poster').hidden")


def test_without_the_code_of_its_controls_a_player_plays(
    page: Page, site: Site, tmp_path: Path
) -> None:
    """A key tries again to load it, and is not lost."""
    page.expect("404", "controls could not be loaded")
    shutil.copytree(nodeprocess.WEB / "bundle", tmp_path / "player")
    (tmp_path / "long").symlink_to(site.folder / "long")
    controls = (tmp_path / "player" / "controls.js").rename(tmp_path / "controls.js")
    with player_host(tmp_path) as url:
        page.open(f"{url}/player/watch.html?src=../long", 160, 120)
        page.wait(f"state.frame > 5 && {SOFT_NOTE}.includes('could not be loaded')")
        assert page.value("part('.bar')") is None
        controls.rename(tmp_path / "player" / "controls.js")
        page.press("k")
        page.wait("element.paused && part('.bar').checkVisibility()")
        assert page.value("part('.scrub').max") == f"{LONG_FRAMES - 1}"


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("manifest.json", "flipped"),
        ("index.bin", "random"),
        ("segments/0/skipmaps", "flipped"),
        ("segments/0/0", "random"),
        ("segments/0/1", "flipped"),
        ("segments/0/keyframe-0", "cut"),
    ],
)
def test_a_file_that_was_altered(page: Page, site: Site, name: str, kind: str) -> None:
    """The page reports the error, or plays without the file; it neither breaks nor hangs."""
    rng = random.Random(name + kind)
    altered = site.folder / f"altered-{name.replace('/', '-')}"
    shutil.copytree(site.folder / "clip", altered)
    data = bytearray((altered / name).read_bytes())
    if kind == "flipped":
        for _ in range(12):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    elif kind == "cut":
        del data[len(data) // 2 :]
    else:
        data[40:] = rng.randbytes(len(data) - 40)
    (altered / name).write_bytes(data)
    page.expect("lacks layer 1")  # which is a warning
    page.open(site.address(altered.name, ""), 160, 120)
    page.wait(f"{NOTE} !== '' || state.frame > 20")
    assert "player failed" not in page.value(NOTE)


def test_a_browser_that_hangs_fails_only_the_test_that_uses_it(
    page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    page.open("about:blank")
    with monkeypatch.context() as patched:
        patched.setattr(nodeprocess, "ANSWER_S", 0.5)
        with pytest.raises(AssertionError, match="did not answer"):
            page.run("await new Promise(() => {});")
    page.open("about:blank")
    assert page.run("return 3") == 3
