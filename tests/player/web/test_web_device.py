"""A phone turns the camera and shares links, and in flight held keys move it."""

from __future__ import annotations

from collections.abc import Iterator
from urllib.parse import parse_qs, urlsplit

import numpy as np
import numpy.typing as npt
import pytest

from codec.tools.static import export_static
from tests.support.commands import ROOT
from tests.support.hosted_streams import static_host, write_stream
from tests.support.web.canvas import ELEMENT, PLAYER
from tests.support.web.chromium import Page

SHADOW = f"{ELEMENT}.shadowRoot"


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The player's page, paused at the first frame."""
    folder = tmp_path_factory.mktemp("device")
    write_stream(folder / "stream", 60)
    export_static(folder / "stream", folder / "static")
    (folder / "web").symlink_to(ROOT / "player" / "web")
    with static_host(folder) as host:
        yield f"{host}/web/watch.html?src=../static&autoplay=0"


@pytest.fixture
def phone(page: Page, url: str) -> Iterator[Page]:
    page.open(url, 390, 600, touch=True, options={"isMobile": True})
    page.wait(f"{PLAYER}?.shownFrame === 0")
    yield page
    assert not page.complaints


TURN_PHONE = """
const turned = { alpha: value[0], beta: value[1], gamma: 0 };
window.dispatchEvent(new DeviceOrientationEvent("deviceorientation", turned));
"""


def test_the_gyroscope_turns_the_camera_until_it_is_off(phone: Page) -> None:
    assert phone.run(f"return {ELEMENT}.hasGyroscope")
    assert phone.run(f"return {ELEMENT}.toggleGyroscope()") is True
    phone.run(TURN_PHONE, [10, 80])
    assert phone.run(f"return {ELEMENT}.view") == "0,0,1,0,0"  # turns count from there
    phone.run(TURN_PHONE, [20, 75])
    phone.wait(f"{ELEMENT}.view !== '0,0,1,0,0'")
    turned = phone.run(f"return {ELEMENT}.view")
    turn, tilt, *others = map(float, turned.split(","))
    assert abs(turn) == pytest.approx(np.radians(10), abs=0.02)
    assert abs(tilt) == pytest.approx(np.radians(5), abs=0.02)
    assert others == [1, 0, 0]
    assert phone.run(f"return {ELEMENT}.toggleGyroscope()") is False
    phone.run(TURN_PHONE, [50, 60])
    assert phone.run(f"return [{ELEMENT}.view, {ELEMENT}.isGyroscopeOn]") == [turned, False]


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
    phone.run(f"{ELEMENT}.currentTime = 1; {ELEMENT}.view = '0.2,0.1,1,0,0'")
    phone.wait(f"{PLAYER}.shownFrame === 30 && !{PLAYER}.isSeeking")
    for count, refusal in enumerate([None, "AbortError", "NotAllowedError"], 1):
        phone.run(SHARE, refusal)
        phone.run(f"{SHADOW}.querySelector('.more').click()")
        entry = f"{SHADOW}.querySelector('.menu:not([hidden]) [data-name=share]')"
        phone.wait(entry)
        phone.run(f"{entry}.click()")
        phone.wait(f"shared.length === {count}")
    phone.wait("copied.length > 0")
    shared, copied = phone.run("return [shared, copied]")
    query = parse_qs(urlsplit(shared[0]["url"]).query)
    assert float(query["t"][0]) == 1
    assert query["view"] == ["0.2,0.1,1,0,0"]
    # Closing the dialog ends it; a page that may not share copies the link.
    assert copied == [shared[2]["url"]]


def pose_of(page: Page) -> npt.NDArray[np.float64]:
    """(4, 4) world-to-camera matrix."""
    return np.array(page.run(f"return {PLAYER}.camera.w2c")).reshape(4, 4)


def test_in_flight_a_held_key_moves_the_camera(page: Page, url: str) -> None:
    page.open(url, 480, 320)
    page.wait(f"{PLAYER}?.shownFrame === 0")
    before = pose_of(page)
    key = "new KeyboardEvent(value, { key: 'w', bubbles: true, composed: true })"
    page.press("g")
    page.run(f"{ELEMENT}.dispatchEvent({key})", "keydown")
    far = f"Math.hypot(...[3, 7, 11].map((at) => {PLAYER}.camera.w2c[at] - value[at]))"
    page.run(f"window.movedM = (value) => {far}")
    page.wait(f"movedM({before.ravel().tolist()}) > 0.05")
    page.run(f"{ELEMENT}.dispatchEvent({key})", "keyup")
    page.wait(f"!{PLAYER}.motion.isMoving")
    after = pose_of(page)
    np.testing.assert_allclose(after[:3, :3], before[:3, :3], atol=1e-9)
    forward_m = before[2, 3] - after[2, 3]
    assert forward_m > 0.05
    assert abs(after[:2, 3] - before[:2, 3]).max() < 1e-6
    assert not page.complaints
