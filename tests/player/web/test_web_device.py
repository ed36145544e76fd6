"""A phone turns the camera and shares links, and in flight held keys move it."""

from __future__ import annotations

from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest

from tests.support.web.chromium import Page
from tests.support.web.site import Site


@pytest.fixture
def phone(page: Page, site: Site) -> Page:
    motion = ["accelerometer", "gyroscope", "magnetometer"]
    site.watch(page, "whole", touch=True, options={"isMobile": True, "permissions": motion})
    return page


TURN_PHONE = """
const turned = { alpha: value[0], beta: value[1], gamma: 0 };
window.dispatchEvent(new DeviceOrientationEvent("deviceorientation", turned));
"""


def test_the_gyroscope_turns_the_camera_until_it_is_off(phone: Page) -> None:
    assert phone.value("element.hasGyroscope")
    assert phone.value("element.toggleGyroscope()") is True
    phone.run(TURN_PHONE, [10, 80])
    assert phone.value("element.view") == "0,0,1,0,0"  # turns count from there
    phone.run(TURN_PHONE, [20, 75])
    phone.wait("element.view !== '0,0,1,0,0'")
    turned = phone.value("element.view")
    turn, tilt, *others = map(float, turned.split(","))
    assert abs(turn) == pytest.approx(np.radians(10), abs=0.02)
    assert abs(tilt) == pytest.approx(np.radians(5), abs=0.02)
    assert others == [1, 0, 0]
    assert phone.value("element.toggleGyroscope()") is False
    phone.run(TURN_PHONE, [50, 60])
    assert phone.value("[element.view, element.isGyroscopeOn]") == [turned, False]


SHARE = """
const share = async (data) => {
  window.shared.push(data);
  if (value !== null) throw new DOMException("a test", value);
};
const clipboard = { writeText: async (text) => void window.copied.push(text) };
window.shared ??= [];
window.copied ??= [];
Object.defineProperty(navigator, "share", { value: share, configurable: true });
Object.defineProperty(navigator, "clipboard", { value: clipboard, configurable: true });
"""
"""A device that shares, or refuses with a DOMException of this name."""


def test_the_menu_shares_the_moment_and_the_view(phone: Page) -> None:
    phone.run("element.currentTime = 1; element.view = '0.2,0.1,1,0,0'")
    phone.wait("player.shownFrame === 30 && !player.isSeeking")
    for count, refusal in enumerate([None, "AbortError", "NotAllowedError"], 1):
        phone.run(SHARE, refusal)
        phone.run("part('.more').click()")
        entry = "part('.menu:not([hidden]) [data-name=share]')"
        phone.wait(entry)
        phone.run(f"{entry}.click()")
        phone.wait(f"shared.length === {count}")
    phone.wait("copied.length > 0")
    shared, copied = phone.value("[shared, copied]")
    query = parse_qs(urlsplit(shared[0]["url"]).query)
    assert float(query["t"][0]) == 1
    assert query["view"] == ["0.2,0.1,1,0,0"]
    # Closing the dialog ends it; a page that may not share copies the link.
    assert copied == [shared[2]["url"]]


def test_in_flight_a_held_key_moves_the_camera(page: Page, site: Site) -> None:
    """It moves forward, and does not turn."""
    site.watch(page, "whole")
    before = page.value("player.camera.w2c")
    key = "new KeyboardEvent(value, { key: 'w', bubbles: true, composed: true })"
    page.press("g")
    page.run(f"element.dispatchEvent({key})", "keydown")
    page.wait(f"player.camera.w2c[11] < {before[11] - 0.05}")
    page.run(f"element.dispatchEvent({key})", "keyup")
    page.wait("!player.motion.isMoving")
    after = page.value("player.camera.w2c")
    del before[11], after[11]
    assert after == pytest.approx(before, abs=1e-6)
