"""What the browser player refuses to fetch or to hold, unless the page's address allows it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

from codec.errors import InvalidError
from codec.tools.audit import verify_stream
from codec.tools.static import export_static
from tests.support.hosted_streams import static_host
from tests.support.hostile import refused
from tests.support.slots.many import NUM_GAUSSIANS, write_many
from tests.support.web.chromium import Page
from tests.support.web.site import Site


def refusal(page: Page, address: str) -> str:
    page.open(address, 160, 120)
    page.wait("element.error")
    message: str = page.value("element.error.message")
    return message


def test_objects_of_another_host(page: Page, site: Site) -> None:
    with static_host(site.folder, cors=True) as other:
        away = site.folder / "away"
        away.mkdir()
        shutil.copy(site.folder / "clip" / "index.bin", away)
        manifest = json.loads((site.folder / "clip" / "manifest.json").read_bytes())
        manifest["object_url"] = f"{other}/clip/segments/{{segment}}/{{layer}}"
        (away / "manifest.json").write_text(json.dumps(manifest))
        said = refusal(page, site.address("away"))
        assert f"leads to another host, {other}; other-hosts" in said
        site.watch(page, "away", "other-hosts=1&autoplay=0")


def test_a_page_changes_each_request_and_reads_german(page: Page, site: Site) -> None:
    site.watch(page, "clip", "autoplay=0")
    page.run(
        "element.transformRequest = async (url) => ({ url: url.replace('nowhere', 'clip') });"
        "element.src = '../nowhere'; element.lang = 'de'; document.body.append(element)"
    )
    page.wait("player.shownFrame >= 0 && part('.play')?.ariaLabel === 'Abspielen'")
    assert page.value("[player.base, part('.frame').lang]") == [f"{site.url}/nowhere/", "de"]


def test_a_static_export_brings_its_page(page: Page, site: Site) -> None:
    export_static(site.folder / "trained" / "whole", site.folder / "paged", page=True)
    verify_stream(site.folder / "paged")
    page.open(f"{site.url}/paged/", 320, 240)
    page.wait("player.shownFrame > 2")
    assert page.value("document.title") == "swings"  # it has no title
    # The statistics name the point under the pointer.
    page.run("element.pause(); element.toggleStats()")
    moved = "new PointerEvent('pointermove', { clientX: 160, clientY: 120 })"
    found = "/pointer   (-?[0-9.]+ ){2}-?[0-9.]+$/.test(part('.stats')?.textContent)"
    page.wait(f"player.canvas.dispatchEvent({moved}) && {found}")  # they are loaded first
    refused(InvalidError, "pack writes one file", export_static, "s", Path("a.swings"))


def test_2_to_the_24_gaussians(page: Page, site: Site) -> None:
    write_many(site.folder / "many")
    said = refusal(page, site.address("many"))
    assert "has 16,777,216 Gaussians; max-gaussians=16777216" in said
    # If allowed, it fails at the next step: the device's textures.
    said = refusal(page, site.address("many", f"max-gaussians={NUM_GAUSSIANS}&autoplay=0"))
    assert "need a texture" in said
