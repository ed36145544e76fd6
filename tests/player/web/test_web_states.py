"""The player's states: each is accessible, and its controls do what users expect."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from codec.stream.poster import StoryboardLayout
from tests.support.suite.once import made_once
from tests.support.web.chromium import Page
from tests.support.web.playerstates import (
    NUM_FRAMES,
    STATES,
    Hosts,
    Reached,
    Screen,
    clicks,
    hosting,
    shows,
    within,
    write_hosted,
)

DESK = Screen("desk", 760, 360)
PHONE = Screen("phone", 360, 400, touch=True)
QUICK = ("no-webgl", "forced-menu")
"""States of which no other test of this file checks that they are accessible."""


@pytest.fixture(scope="module")
def hosts(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hosts]:
    folder = tmp_path_factory.mktemp("states")
    for path in made_once(tmp_path_factory, "web-states", write_hosted).iterdir():
        (folder / path.name).symlink_to(path)
    with hosting(folder) as found:
        yield found


@pytest.fixture
def desk(page: Page, hosts: Hosts) -> Reached:
    return Reached(page, hosts, DESK)


@pytest.fixture
def phone(page: Page, hosts: Hosts) -> Reached:
    return Reached(page, hosts, PHONE)


def check_accessible(page: Page) -> None:
    assert page.axe("swings-player") == []


@pytest.mark.parametrize(
    "state", [pytest.param(s, marks=() if s in QUICK else pytest.mark.deep) for s in STATES]
)
def test_no_state_has_a_fault_that_axe_finds(desk: Reached, state: str) -> None:
    desk.page.expect("404")
    desk.reach(STATES[state])
    check_accessible(desk.page)
    # Another try does not bring WebGL2; its pictures show one after the other.
    assert desk.page.value("part('.retry').checkVisibility()") is state.startswith("failed")
    if state == "no-webgl":
        desk.page.wait("part('.slides .tile').offsetHeight === 360")
        place = "part('.slides .tile').style.backgroundPosition"
        desk.page.wait(f"{place} !== {desk.page.value(place)!r}")
        assert desk.page.value("part('.failure').getBoundingClientRect().top > 250")


def test_a_tap_on_a_hidden_bar_shows_it_and_presses_nothing(phone: Reached) -> None:
    page = phone.page
    phone.watch("src=../static&loop=1")
    page.wait("part('.frame.idle')")
    place = "const box = part('.more').getBoundingClientRect(); "
    at_px = tuple(page.run(place + "return [box.x + box.width / 2, box.y + box.height / 2]"))
    page.tap(at_px)
    page.wait("!part('.frame.idle')")
    assert page.value("part('.menu').hidden")
    page.run("element.pause()")  # now the bar stays
    page.tap(at_px)
    page.wait("part('.menu')?.hidden === false")
    page.tap((30, 40))
    page.wait("part('.menu').hidden")
    buttons = "[...element.shadowRoot.querySelectorAll('.bar button, .bar input')]"
    seen = f"{buttons}.filter((one) => one.checkVisibility())"
    boxes = f"{seen}.map((one) => one.getBoundingClientRect())"
    least = page.value(f"{boxes}.map((box) => Math.min(box.width, box.height))")
    assert len(least) >= 5  # seek, play, share, more, full screen
    assert min(least) >= 44


def test_the_large_button_plays_and_plays_again(desk: Reached) -> None:
    page = desk.page
    desk.watch("src=../static&autoplay=0&loop=0&t=3.6")
    desk.do(within("start"))
    check_accessible(page)
    stops = "[...element.shadowRoot.querySelectorAll('button')].filter((one) => one.tabIndex >= 0)"
    assert page.value(f"{stops}.filter((one) => one.ariaLabel === 'Play').length") == 1
    page.click("swings-player .large")
    desk.do(within("ended"))
    check_accessible(page)
    assert page.value("part('.large').getAttribute('aria-label')") == "Play again"
    assert page.value("!part('.frame.idle')")
    page.run("element.playbackRate = 0.25")
    page.click("swings-player .large")
    page.wait("player.shownFrame < 100 && !element.paused")
    assert page.value("part('.large').hidden")


def test_a_failure_is_a_sentence_and_may_be_tried_again(desk: Reached) -> None:
    page, folder = desk.page, desk.hosts.folder
    page.expect("404")
    desk.watch("src=../later&autoplay=0&t=1")
    desk.do(within("failed"))
    sentence = page.value("part('.sentence').textContent")
    assert sentence == "This video does not exist, or is not here any more."
    assert "HTTP 404" in page.value("part('.failure .note').textContent")
    assert page.value("player.workers === null"), "its workers and their memory are free"
    assert not page.value("part('.bar').checkVisibility()")
    check_accessible(page)
    desk.do(*clicks("summary"))
    check_accessible(page)
    (folder / "later").symlink_to(folder / "static")
    page.click("swings-player .retry")
    page.wait("player.shownFrame === 30")
    assert page.value("part('.bar').checkVisibility() && element.error === null")


def test_a_still_has_no_time_and_turns_until_it_is_touched(desk: Reached) -> None:
    page = desk.page
    desk.watch("src=../model")
    desk.do(within("still"))
    names = "[...part('.row').children].filter((one) => one.checkVisibility())"
    assert page.value(f"{names}.map((one) => one.className)") == [
        "space", "share", "reset", "quality", "more", "full",
    ]  # fmt: skip
    assert not page.value("part('.scrub').checkVisibility() || part('.large').checkVisibility()")
    page.wait("Number(element.view.split(',')[0]) > 0.05")
    page.drag((300, 100), (301, 100))
    page.wait_until_still("element.view")
    page.press("k")
    desk.watch("src=../model", options={"reducedMotion": "reduce"})
    desk.do(within("still"))
    page.wait_until_still("element.view")
    assert page.value("element.view") == "0,0,1,0,0"


def test_a_first_visit_is_told_once_that_one_may_look_around(desk: Reached) -> None:
    stays = "const after = setTimeout; window.setTimeout = (act, ms) => ms > 5e3 || after(act, ms);"
    forget = "delete localStorage['swings-player-looked'];"
    for before, told in (forget, "Drag to look around"), ("", ""):
        desk.watch("src=../static", stays + before)
        desk.page.wait(f"state.frame > 20 && part('.note.soft').textContent === '{told}'")
    assert desk.page.value("localStorage['swings-player-looked']") == "1"


def test_the_menu_by_keys(phone: Reached) -> None:
    page = phone.page
    phone.watch("src=../static&autoplay=0&loop=0")
    phone.do(within("start"))

    def focused() -> str:
        name: str = page.value("element.shadowRoot.activeElement.dataset.name")
        return name

    page.run("part('.more').focus()")
    page.press("Enter")
    page.wait("part('.menu')?.hidden === false")
    assert focused() == "rate"
    assert page.value("part('.more').getAttribute('aria-expanded')") == "true"
    check_accessible(page)
    page.press("ArrowRight")
    check_accessible(page)
    page.press("ArrowDown")
    page.press("Enter")
    assert page.value("element.playbackRate") == 1.5
    page.press("Enter")
    page.press("ArrowUp")
    assert focused() == "statistics"
    page.run("part('[data-name=loop]').focus()")
    page.press("Enter")
    assert page.value("element.loop")
    page.press("Enter")
    page.press("Escape")
    assert page.value("element.shadowRoot.activeElement.className") == "more"
    assert page.value("part('.menu').hidden")
    assert page.value("player.shownFrame") == 0  # the player left the arrows to the menu


def test_the_menu_saves_the_picture_the_frame_and_the_stream(desk: Reached) -> None:
    page = desk.page
    desk.watch("src=../static&autoplay=0&t=1")
    page.wait("player.shownFrame === 30 && part('.bar')")
    page.run("element.setAttribute('download', 'one.swings')")
    page.run("HTMLAnchorElement.prototype.click = () => {}")
    page.run("URL.createObjectURL = (blob) => { window.saved = blob; return 'data:,'; }")
    page.run("document.createElement = ((make) => (tag) => (window.made = make(tag)))"
             "(document.createElement.bind(document))")  # fmt: skip
    desk.do(*clicks(".more"), *clicks("[data-name=save]"))
    page.wait("window.saved?.type === 'image/png' && made.download === 'frame-30.png'")
    size = "const { width, height } = await createImageBitmap(saved); return [width, height]"
    assert page.run(size) == page.value("[player.canvas.width, player.canvas.height]")
    desk.do(*clicks(".more"), *clicks("[data-name=save-frame]"))
    page.wait("made.download === 'frame-30.ply'")
    assert page.run("return (await saved.text()).slice(0, 4)") == "ply\n"
    desk.do(*clicks(".more"), *clicks("[data-name=download]"))
    page.wait("made.href === new URL('one.swings', document.baseURI).href")


def test_the_keys_of_the_player(desk: Reached) -> None:
    page = desk.page
    desk.watch("src=../static&autoplay=0")
    desk.do(within("start"))
    # Keys work before anything is clicked.
    page.press("i")
    desk.do(shows(".stats"))
    page.press("i")
    page.press("Space")
    page.wait("state.playing && state.frame >= 5")
    page.press("Space")
    page.wait("!state.playing")
    steps = [
        ("5", 60), (".", 61), (",", 60), ("l", 84), ("j", 60), ("ArrowRight", 72),
        ("ArrowLeft", 60), ("End", NUM_FRAMES - 1), ("Home", 0),
    ]  # fmt: skip
    for key, frame in steps:
        page.press(key)
        page.wait(f"player.shownFrame === {frame}")
    page.press(">")
    assert page.value("element.playbackRate") == 1.5
    page.press("<")
    assert page.value("element.playbackRate") == 1
    page.press("Tab")
    page.wait("element.shadowRoot.activeElement.matches('.scrub')")
    page.press("o")
    assert page.value("element.loop") is False
    page.press("End")
    page.wait(f"player.shownFrame === {NUM_FRAMES - 1}")
    began = "() => (window.hasBegun ||= player.shownFrame < 90)"
    page.run(f"player.addEventListener('shown', {began})")
    page.click("swings-player .play")
    page.wait("window.hasBegun")
    page.press("?")
    page.wait("part('dialog')?.open")
    assert "Next frame" in page.value("part('dialog').textContent")
    check_accessible(page)
    page.press("Escape")
    page.wait("!part('dialog')?.open")


def test_a_small_picture_over_the_thumb(desk: Reached) -> None:
    desk.reach(STATES["preview"])
    check_accessible(desk.page)
    layout = StoryboardLayout.of(NUM_FRAMES, 30.0)
    tile = 90 // layout.step_frames
    x, y = tile % layout.columns, tile // layout.columns
    place = f"{100 * x / (layout.columns - 1)}% {100 * y / (layout.rows - 1) if y else 0}%"
    style = "getComputedStyle(part('.tile'))"
    found = desk.page.value(f"{style}.backgroundPosition")
    assert [float(one.rstrip("%")) for one in found.split()] == pytest.approx(
        [float(one.rstrip("%")) for one in place.split()], abs=0.01
    )
    assert desk.page.value("part('.hover-time').textContent") == "0:03.0"


def test_without_full_screen_the_player_covers_the_page(desk: Reached) -> None:
    page = desk.page
    desk.watch("src=../static&autoplay=0", "delete Element.prototype.requestFullscreen;")
    desk.do(within("start"))
    page.run("element.style.width = '300px'; element.style.height = '200px'")
    page.click("swings-player .full")
    page.wait(f"element.clientWidth === {DESK.width_px}")
    assert page.value("part('.full').getAttribute('aria-label')") == "Exit full screen"
    page.press("Escape")
    page.wait("element.clientWidth === 300")


def page_under(hosts: Hosts, trusted_types: str, more: str) -> str:
    """The URL of a page with the player that is under such a policy."""
    policy = f"require-trusted-types-for 'script'; trusted-types {trusted_types}"
    (hosts.folder / "typed.html").write_text(
        '<!doctype html><link rel="icon" href="data:," />'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}" />'
        f'<script type="module" src="player/player.js"></script>{more}'
    )
    return f"{hosts.url}/typed.html"


def test_under_trusted_types(page: Page, hosts: Hosts) -> None:
    page.open(page_under(hosts, "'none'", "<swings-player>"))
    page.wait("part('.more')")
    page.press("Tab")
    page.run("part('.more').click()")
    page.wait("part('[data-name=keys]')")
    page.run("part('[data-name=keys]').click()")
    page.wait("part('dialog')?.open")


def test_two_copies_of_the_code_share_the_policy_of_trusted_types(page: Page, hosts: Hosts) -> None:
    more = '<swings-player src="static"></swings-player>'
    page.open(page_under(hosts, "swings-worker", more), 160, 120)
    page.wait("player.shownFrame === 0")
    feed = "const { GaussianFeed } = await import('./player/gaussianfeed.js');"  # another copy
    code = f"{feed} return (await new GaussianFeed('static').opened).numFrames"
    assert page.run(code) == NUM_FRAMES
    others = "https://other.example/evil.js", "https://other.example/playworker.js"
    for url in *others, f"{hosts.url}/static/manifest.json":
        steal = "window[Symbol.for('swings-worker ' + origin)].createScriptURL(value)"
        code = f"try {{ {steal}; }} catch (error) {{ return error.name; }}"
        assert page.run(code, url) == "TypeError"


def test_a_retry_keeps_time_rate_and_view(desk: Reached) -> None:
    page = desk.page
    desk.watch("src=../static&autoplay=0&t=1")
    page.wait("player.shownFrame === 30")
    page.run("element.playbackRate = 1.5; element.view = '0.2,0.1,0.9,0,0'")
    for _ in range(2):
        page.run("player.fail('The player failed: a test')")
        desk.do(within("failed"))
        page.click("swings-player .retry")
        page.wait("player.shownFrame === 30 && element.error === null")
    page.wait("element.view === '0.2,0.1,0.9,0,0'")
    assert page.value("element.playbackRate") == 1.5
    assert page.value("element.getAttribute('view')") is None
    page.run("element.load()")
    page.wait("player.shownFrame === 30")
    assert page.value("[element.playbackRate, element.view]") == [1, "0,0,1,0,0"]
