"""The player's states: each is accessible, and its controls do what users expect."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from codec.stream.storyboard import StoryboardLayout
from tests.support.web.chromium import Page
from tests.support.web.playerstates import (
    ELEMENT,
    NUM_FRAMES,
    PLAYER,
    STATES,
    Hosts,
    Reached,
    Screen,
    hosting,
)

DESK = Screen("desk", 760, 360)
PHONE = Screen("phone", 360, 400, touch=True)
ROOT = f"{ELEMENT}.shadowRoot"
QUICK = ("start", "menu", "speed", "keys", "preview", "failed-details", "no-webgl", "forced-menu")


@pytest.fixture(scope="module")
def hosts(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hosts]:
    with hosting(tmp_path_factory.mktemp("states")) as found:
        yield found


@pytest.fixture
def desk(page: Page, hosts: Hosts) -> Reached:
    return Reached(page, hosts, DESK)


@pytest.fixture
def phone(page: Page, hosts: Hosts) -> Reached:
    return Reached(page, hosts, PHONE)


def part(selector: str) -> str:
    return f"{ROOT}.querySelector('{selector}')"


@pytest.mark.parametrize(
    "state", [pytest.param(s, marks=() if s in QUICK else pytest.mark.slow) for s in STATES]
)
def test_no_state_has_a_fault_that_axe_finds(desk: Reached, state: str) -> None:
    STATES[state](desk)
    assert desk.page.axe("swings-player") == []


def test_a_tap_on_a_hidden_bar_shows_it_and_presses_nothing(phone: Reached) -> None:
    page = phone.page
    phone.watch("src=../static&loop=1")
    page.wait(f"{part('.frame.idle')}", 60)
    place = f"const box = {part('.more')}.getBoundingClientRect(); "
    at_px = tuple(page.run(place + "return [box.x + box.width / 2, box.y + box.height / 2]"))
    page.tap(at_px)
    page.wait(f"!{part('.frame.idle')}")
    assert page.run(f"return {part('.menu')} === null")
    page.tap(at_px)
    page.wait(f"{part('.menu')}?.hidden === false")
    page.tap((30, 40))
    page.wait(f"{part('.menu')}.hidden")
    buttons = f"[...{ROOT}.querySelectorAll('.bar button, .bar input')]"
    seen = f"{buttons}.filter((one) => one.checkVisibility())"
    boxes = f"{seen}.map((one) => one.getBoundingClientRect())"
    least = page.run(f"return {boxes}.map((box) => Math.min(box.width, box.height))")
    assert len(least) == 4  # seek, play, more, full screen
    assert min(least) >= 44


def test_the_large_button_plays_and_plays_again(desk: Reached) -> None:
    page = desk.page
    desk.watch("src=../static&autoplay=0&loop=0&t=3.6")
    desk.wait("start")
    page.click("swings-player .large")
    desk.wait("ended")
    assert page.run(f"return {part('.large')}.getAttribute('aria-label')") == "Play again"
    assert page.run(f"return !{part('.frame.idle')}")
    page.click("swings-player .large")
    page.wait(f"{PLAYER}.shownFrame < 100 && !{ELEMENT}.paused", 30)
    assert page.run(f"return {part('.large')}.hidden")


def test_a_failure_is_a_sentence_and_may_be_tried_again(desk: Reached) -> None:
    page, folder = desk.page, desk.hosts.folder
    desk.watch("src=../later&autoplay=0&t=1")
    desk.wait("failed")
    sentence = page.run(f"return {part('.sentence')}.textContent")
    assert sentence == "This video does not exist, or is not here any more."
    assert "HTTP 404" in page.run(f"return {part('.failure .note')}.textContent")
    assert not page.run(f"return {part('.bar')}.checkVisibility()")
    (folder / "later").symlink_to(folder / "static")
    page.click("swings-player .retry")
    page.wait(f"{PLAYER}.shownFrame === 30", 60)
    assert page.run(f"return {part('.bar')}.checkVisibility() && {ELEMENT}.error === null")


def test_the_menu_by_keys(phone: Reached) -> None:
    page = phone.page
    phone.watch("src=../static&autoplay=0&loop=0")
    phone.wait("start")

    def focused() -> str:
        name: str = page.run(f"return {ROOT}.activeElement.dataset.name")
        return name

    page.run(f"{part('.more')}.focus()")
    page.press("Enter")
    page.wait(f"{part('.menu')}?.hidden === false")
    assert focused() == "rate"
    assert page.run(f"return {part('.more')}.getAttribute('aria-expanded')") == "true"
    page.press("ArrowRight")
    page.press("ArrowDown")
    page.press("Enter")
    assert page.run(f"return {ELEMENT}.playbackRate") == 1.5
    page.press("Enter")
    page.press("ArrowUp")
    assert focused() == "keys"
    page.press("Home")
    for _ in range(4):
        page.press("ArrowDown")
    assert focused() == "loop"
    page.press("Enter")
    assert page.run(f"return {ELEMENT}.loop")
    page.press("Enter")
    page.press("Escape")
    assert page.run(f"return {ROOT}.activeElement.className") == "more"
    assert page.run(f"return {part('.menu')}.hidden")
    assert page.run(f"return {PLAYER}.shownFrame") == 0  # the player left the arrows to the menu


def test_the_keys_of_the_player(desk: Reached) -> None:
    page = desk.page
    desk.watch("src=../static&autoplay=0")
    desk.wait("start")
    steps = [
        ("5", 60), (".", 61), (",", 60), ("l", 84), ("j", 60), ("ArrowRight", 72),
        ("ArrowLeft", 60), ("End", NUM_FRAMES - 1), ("Home", 0),
    ]  # fmt: skip
    for key, frame in steps:
        page.press(key)
        page.wait(f"{PLAYER}.shownFrame === {frame}", 30)
    page.press(">")
    assert page.run(f"return {ELEMENT}.playbackRate") == 1.5
    page.press("<")
    assert page.run(f"return {ELEMENT}.playbackRate") == 1
    page.press("o")
    assert page.run(f"return {ELEMENT}.loop") is False
    page.press("?")
    page.wait(f"{part('dialog')}?.open")
    assert "Next frame" in page.run(f"return {part('dialog')}.textContent")
    page.press("Escape")
    page.wait(f"!{part('dialog')}?.open")


def test_a_small_picture_over_the_thumb(desk: Reached) -> None:
    STATES["preview"](desk)
    layout = StoryboardLayout.of(NUM_FRAMES, 30.0)
    tile = 90 // layout.step_frames
    x, y = tile % layout.columns, tile // layout.columns
    place = f"{100 * x / (layout.columns - 1)}% {100 * y / (layout.rows - 1) if y else 0}%"
    style = f"getComputedStyle({part('.tile')})"
    found = desk.page.run(f"return {style}.backgroundPosition")
    assert [float(one.rstrip("%")) for one in found.split()] == pytest.approx(
        [float(one.rstrip("%")) for one in place.split()], abs=0.01
    )
    assert desk.page.run(f"return {part('.hover-time')}.textContent") == "0:03.0"


def test_without_full_screen_the_player_covers_the_page(desk: Reached) -> None:
    page = desk.page
    desk.watch("src=../static&autoplay=0", "delete Element.prototype.requestFullscreen;")
    desk.wait("start")
    page.run(f"{ELEMENT}.style.width = '300px'; {ELEMENT}.style.height = '200px'")
    page.click("swings-player .full")
    page.wait(f"{ELEMENT}.clientWidth === {DESK.width_px}")
    assert page.run(f"return {part('.full')}.getAttribute('aria-label')") == "Exit full screen"
    page.press("Escape")
    page.wait(f"{ELEMENT}.clientWidth === 300")


def test_under_trusted_types(page: Page, hosts: Hosts, tmp_path: Path) -> None:
    policy = "require-trusted-types-for 'script'; trusted-types 'none'"
    (hosts.folder / "typed.html").write_text(
        f'<!doctype html><link rel="icon" href="data:," />'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}" />'
        '<script type="module" src="web/element/swingsplayer.js"></script><swings-player>'
    )
    page.open(f"{hosts.url}/typed.html")
    page.wait(f"{ELEMENT}.player")
    page.press("Tab")
    page.run(f"{part('.more')}.click()")
    page.wait(part("[data-name=keys]"))
    page.run(f"{part('[data-name=keys]')}.click()")
    page.wait(f"{part('dialog')}?.open")
    assert not page.complaints


def test_two_copies_of_the_code_share_the_policy_of_trusted_types(page: Page, hosts: Hosts) -> None:
    policy = "require-trusted-types-for 'script'; trusted-types swings-worker"
    (hosts.folder / "again").symlink_to((hosts.folder / "web").resolve())
    (hosts.folder / "twice.html").write_text(
        f'<!doctype html><link rel="icon" href="data:," />'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}" />'
        '<script type="module" src="web/element/swingsplayer.js"></script>'
        '<swings-player src="static"></swings-player>'
    )
    page.open(f"{hosts.url}/twice.html")
    page.wait(f"{PLAYER}?.shownFrame === 0")
    feed = "const { GaussianFeed } = await import('./again/feed/gaussianfeed.js');"
    code = f"{feed} return (await new GaussianFeed('static').opened).numFrames"
    assert page.run(code) == NUM_FRAMES
    assert not page.complaints


def test_a_retry_keeps_time_rate_and_view(desk: Reached) -> None:
    page = desk.page
    desk.watch("src=../static&autoplay=0&t=1")
    page.wait(f"{PLAYER}?.shownFrame === 30")
    page.run(f"{ELEMENT}.playbackRate = 1.5; {ELEMENT}.view = '0.2,0.1,0.9,0,0'")
    for _ in range(2):
        page.run(f"{PLAYER}.fail('The player failed: a test')")
        desk.wait("failed")
        page.click("swings-player .retry")
        page.wait(f"{PLAYER}.shownFrame === 30 && {ELEMENT}.error === null")
    page.wait(f"{ELEMENT}.view === '0.2,0.1,0.9,0,0'")
    assert page.run(f"return {ELEMENT}.playbackRate") == 1.5
    assert page.run(f"return {ELEMENT}.getAttribute('view')") is None
    page.run(f"{ELEMENT}.load()")
    page.wait(f"{PLAYER}.shownFrame === 30")
    assert page.run(f"return [{ELEMENT}.playbackRate, {ELEMENT}.view]") == [1, "0,0,1,0,0"]
