"""Mouse, fingers and the size of the window: the page then draws what the CPU renderer does."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import pytest

from codec.stream import StreamReader
from codec.tools.static import export_static
from tests.support.hosted_streams import static_host, write_stream
from tests.support.web.browsercamera import from_browser
from tests.support.web.canvas import (
    LEAST_PSNR_DB,
    PIXELS,
    PLAYER,
    canvas_of,
    expected_of,
    psnr_db,
)
from tests.support.web.chromium import Page

ROOT = Path(__file__).parents[3]
WIDTH_PX, HEIGHT_PX = 480, 320

Opened = Callable[..., AbstractContextManager[Page]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the page and a stream of 2,000 Gaussians a frame, all of them in one layer."""
    tmp_path = tmp_path_factory.mktemp("gestures")
    stream = write_stream(tmp_path / "stream", 20, slice_size=500, layers=(1.0,))
    export_static(stream, tmp_path / "static")
    (tmp_path / "web").symlink_to(ROOT / "player" / "web")
    return tmp_path


@pytest.fixture
def opened(page: Page, folder: Path) -> Opened:
    """Opens the page, paused at the first frame."""

    @contextmanager
    def opening(touch: bool = False) -> Iterator[Page]:
        with static_host(folder) as url:
            address = f"{url}/web/watch.html?src=../static&autoplay=0"
            page.open(address, WIDTH_PX, HEIGHT_PX, touch=touch, scripts=[PIXELS])
            page.wait(f"{PLAYER}?.shownFrame === 0", 60)
            yield page
            assert not page.complaints

    return opening


def view_of(page: Page) -> tuple[float, float, float, float, float]:
    """How the camera is turned, tilted, zoomed, and moved to the right and down."""
    turn, tilt, zoom, right, down = map(float, page.run(f"return {PLAYER}.orbit.text").split(","))
    return turn, tilt, zoom, right, down


def check_picture(page: Page, folder: Path) -> None:
    """The canvas shows what the CPU renderer sees from where the page's camera is."""
    camera = from_browser(page.run(f"return {PLAYER}.camera"))
    expected = expected_of(StreamReader(folder / "stream"), camera)
    assert psnr_db(canvas_of(page), expected) >= LEAST_PSNR_DB


def test_a_mouse_turns_moves_and_comes_closer(opened: Opened, folder: Path) -> None:
    with opened() as page:
        page.drag((240, 120), (300, 140))
        turn, tilt, *others = view_of(page)
        assert turn != 0
        assert tilt != 0
        assert others == [1, 0, 0]
        page.drag((240, 120), (200, 150), button="right")
        assert view_of(page)[:3] == (turn, tilt, 1)
        assert view_of(page)[3:] != (0, 0)
        page.press("+")
        assert view_of(page)[2] < 1
        check_picture(page, folder)
        page.press("r")
        assert view_of(page) == (0, 0, 1, 0, 0)


def test_a_finger_turns_and_two_come_closer(opened: Opened, folder: Path) -> None:
    with opened(touch=True) as page:
        page.touch([(200, 100)], [(220, 110)], [(260, 120)])
        turn, tilt, zoom, *_ = view_of(page)
        assert turn != 0
        assert tilt != 0
        assert zoom == 1
        page.touch(*([(240 - apart, 120), (240 + apart, 120)] for apart in (30, 45, 60)))
        found = view_of(page)
        assert found[:2] == (turn, tilt)
        assert found[2] == pytest.approx(0.5, rel=0.1)
        check_picture(page, folder)
        page.touch([(100, 100), (200, 100)], [(120, 130), (220, 130)], [(140, 160), (240, 160)])
        assert view_of(page)[3:] != found[3:]


@pytest.mark.parametrize(("width_px", "height_px"), [(800, 300), (390, 700)])
def test_a_window_of_another_size(
    opened: Opened, folder: Path, width_px: int, height_px: int
) -> None:
    with opened() as page:
        page.resize(width_px, height_px)
        page.wait(f"{PLAYER}.canvas.width === {width_px} && {PLAYER}.canvas.height === {height_px}")
        check_picture(page, folder)
        page.resize(WIDTH_PX, HEIGHT_PX)
        page.wait(f"{PLAYER}.canvas.width === {WIDTH_PX}")
        check_picture(page, folder)
