"""The page plays a stream from a plain file server as expected."""

from __future__ import annotations

import random
import shutil
from pathlib import Path

import pytest

from tests.support.hosted_streams import static_host
from tests.support.web import nodeprocess
from tests.support.web.chromium import Page
from tests.support.web.site import CLIP_FRAMES, SLOW_DOWN, Site, player_host, watch

NOTE = "part('.note:not(.soft)').textContent"
SOFT_NOTE = "part('.note.soft').textContent"


def test_it_plays_pauses_seeks_and_ends(page: Page, site: Site) -> None:
    site.watch(page, "clip", size_px=(480, 320))
    assert page.value("state.playing") is False
    # Keys work before anything is clicked.
    page.press("i")
    page.wait("part('.stats').hidden === false")
    page.press("i")
    page.press("Space")
    page.wait("state.playing && state.frame >= 5")
    page.press("Space")
    page.wait("!state.playing")
    page.press("Tab")
    page.wait("element.shadowRoot.activeElement.className === 'scrub'")
    page.press("o")
    page.press("End")
    page.wait(f"player.shownFrame === {CLIP_FRAMES - 1}")
    began = "() => (window.hasBegun ||= player.shownFrame < 30)"
    page.run(f"element.focus(); player.addEventListener('shown', {began})")
    page.click("swings-player .play")
    page.wait("window.hasBegun")


def test_a_host_that_is_gone_for_a_while_and_a_stream_that_is_not_there(
    page: Page, site: Site, tmp_path: Path
) -> None:
    page.expect("404", "ERR_CONNECTION_REFUSED", "ERR_CONNECTION_RESET", "ERR_EMPTY_RESPONSE")
    (tmp_path / "long").symlink_to(site.folder / "long")
    with player_host(tmp_path) as url:
        watch(page, f"{url}/player/watch.html?src=../long")
        page.wait(f"state.endFrame > 60 && {SLOW_DOWN}")
    page.wait(f"{SOFT_NOTE}.includes('trying again')")
    with static_host(tmp_path, int(url.rpartition(":")[2])):
        page.wait(f"{SOFT_NOTE} === ''")
        end = page.value("state.endFrame")
        page.run("element.playbackRate = 1")
        page.wait(f"state.endFrame > {end + 30}")
        page.run("element.setAttribute('src', '../nothing')")
        page.wait(f"{NOTE}.includes('HTTP 404')")


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
