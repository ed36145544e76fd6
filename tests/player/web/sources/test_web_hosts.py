"""The browser player fetches a stream's files only from the manifest's own origin, unless more is
allowed."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from codec.errors import CorruptError
from codec.tools.static import export_static
from tests.support.commands import ROOT
from tests.support.hosted_streams import static_host, write_stream
from tests.support.web.browsercode import BrowserCode
from tests.support.web.chromium import Page

PLAYER = "document.querySelector('swings-player')"
TEMPLATE = "stream/segments/{segment}/{layer}"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("host")
    write_stream(folder / "trained", 10)
    export_static(folder / "trained", folder / "stream")
    (folder / "web").symlink_to(ROOT / "player" / "web")
    return folder


def lead(folder: Path, object_url: str, name: str = "away") -> str:
    """Makes a stream whose manifest refers to `object_url`; returns its folder's name."""
    (folder / name).mkdir(exist_ok=True)
    shutil.copy(folder / "stream" / "index.bin", folder / name)
    manifest = json.loads((folder / "stream" / "manifest.json").read_bytes())
    (folder / name / "manifest.json").write_text(json.dumps(manifest | {"object_url": object_url}))
    return name


def test_an_object_of_another_origin_is_refused_unless_it_is_allowed(
    browser: BrowserCode, folder: Path
) -> None:
    with static_host(folder) as host, static_host(folder) as other:
        port = other.rpartition(":")[2]
        away = f"{host}/{lead(folder, f'{other}/{TEMPLATE}')}/"
        failed = browser.ask("firstObject", url=away)["failed"]
        assert failed == (
            f"{away}manifest.json leads to another host, {other}; other-hosts, as an attribute of "
            "the player or other-hosts=1 in the address of its page, allows it"
        )
        size = (folder / "stream" / "segments" / "0" / "0").stat().st_size
        assert browser.ask("firstObject", url=away, otherHosts=True) == {"numBytes": size}
        for template in (
            f"//127.0.0.1:{port}/{TEMPLATE}",
            f"http://localhost:{host.rpartition(':')[2]}/{TEMPLATE}",
            f"\\\\127.0.0.1:{port}/{TEMPLATE}",
            f"https://{host.partition('//')[2]}/{TEMPLATE}",
            "//elsewhere.example/{segment}/{layer}",
            "http://host{segment}.example/{layer}",
        ):
            lead(folder, template)
            failed = browser.ask("firstObject", url=away)["failed"]
            assert "leads to another host" in failed, template
        for template in (f"{host}/{TEMPLATE}", f"/{TEMPLATE}", f"../{TEMPLATE}"):
            lead(folder, template)
            assert browser.ask("firstObject", url=away) == {"numBytes": size}


@pytest.mark.parametrize(
    ("template", "complaint"),
    [
        ("http://[{segment}{layer}", "is not a URL"),
        ("data:text/plain,{segment}{layer}", "is not on the web"),
        ("file:///etc/{segment}{layer}", "is not on the web"),
    ],
)
@pytest.mark.parametrize("other_hosts", [False, True])
def test_what_is_no_url_of_the_web_is_never_fetched(
    browser: BrowserCode, folder: Path, template: str, complaint: str, other_hosts: bool
) -> None:
    lead(folder, template)
    with static_host(folder) as host, pytest.raises(CorruptError, match=complaint):
        browser.ask("firstObject", url=f"{host}/away/", otherHosts=other_hosts)


def test_the_page_says_so_and_its_address_allows_it(page: Page, folder: Path) -> None:
    with static_host(folder) as host, static_host(folder, cors=True) as other:
        lead(folder, f"{other}/{TEMPLATE}")
        watch = f"{host}/web/watch.html?src=../away"
        page.open(watch, 320, 240)
        page.wait(f"{PLAYER}?.error", 30)
        assert f"leads to another host, {other}; other-hosts" in page.run(
            f"return {PLAYER}.error.message"
        )
        page.open(f"{watch}&other-hosts=1&autoplay=0", 320, 240)
        page.wait(f"{PLAYER}?.player?.shownFrame >= 0", 60)
