"""The pages of bench/web play and return measurements."""

from __future__ import annotations

from pathlib import Path

from bench.web.pagestart import SCRIPT
from bench.web.web import write_slots
from tests.support.commands import ROOT
from tests.support.hosted_streams import static_host
from tests.support.web.chromium import Page


def test_the_page_that_measures_plays(page: Page, tmp_path: Path) -> None:
    write_slots(tmp_path / "slots", 600)
    for part in ("player", "bench"):
        (tmp_path / part).symlink_to(ROOT / part)
    with static_host(tmp_path) as host:
        url = f"{host}/bench/web/play.html?src=/slots/static&autoplay=0&loop=0"
        page.open(url, 320, 180, scripts=[SCRIPT])
        page.wait("window.firstPictureMs > 0")
        how = {"rate": 3, "isMoving": False, "uploadsAll": False}
        found = page.run("return window.measure(value)", how)
    assert found["picturesPerS"] > 0
    assert found["drawMs"] > 0
    assert found["device"]
