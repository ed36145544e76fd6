"""The browser player fetches a stream's files only from the manifest's own origin, unless more is
allowed."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from codec.tools.static import export_static
from tests.support.hosted_streams import static_host, write_stream
from tests.support.web.chromium import Page
from tests.support.web.site import player_host, watch

TEMPLATE = "stream/segments/{segment}/{layer}"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("host")
    write_stream(folder / "trained", 10)
    export_static(folder / "trained", folder / "stream")
    return folder


def lead(folder: Path, object_url: str, name: str = "away") -> str:
    """Makes a stream whose manifest refers to `object_url`; returns its folder's name."""
    (folder / name).mkdir(exist_ok=True)
    shutil.copy(folder / "stream" / "index.bin", folder / name)
    manifest = json.loads((folder / "stream" / "manifest.json").read_bytes())
    (folder / name / "manifest.json").write_text(json.dumps(manifest | {"object_url": object_url}))
    return name


def test_the_page_says_so_and_its_address_allows_it(page: Page, folder: Path) -> None:
    with player_host(folder) as host, static_host(folder, cors=True) as other:
        lead(folder, f"{other}/{TEMPLATE}")
        address = f"{host}/player/watch.html?src=../away"
        page.open(address, 160, 120)
        page.wait("element.error")
        told = page.value("element.error.message")
        assert f"leads to another host, {other}; other-hosts" in told
        watch(page, f"{address}&other-hosts=1&autoplay=0")
