"""The browser's picture is that of the CPU renderer."""

from __future__ import annotations

import base64
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from codec.arrays import Doubles
from codec.camera import Camera
from codec.stream.reader import StreamReader
from codec.tools.static import export_static
from player.render.cpu import render_splats
from tests.support.commands import ROOT
from tests.support.hosted_streams import static_host, write_stream
from tests.support.reference_render import cameras_all_round, drawn_psnr_db
from tests.support.slots.moving_updates import write_jumps, write_moving_stream
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout
from tests.support.web.browsercode import fields_in_browser
from tests.support.web.canvas import LEAST_PSNR_DB, psnr_db
from tests.support.web.chromium import Page
from tests.support.web.nodeprocess import SCRIPTS
from tests.support.web.site import player_host, watch

FRAME = 7
LEAST_HALF_WAY_DB, LEAST_BETWEEN_DB = 45.0, 36.0
"""Between two frames the browser mixes covariances, while the CPU mixes sizes and rotations; its
order is always that of halfway."""


def made_stream(path: Path, kind: str) -> Path:
    if kind == "whole slices, SH 1":
        return write_stream(path, FRAME + 2, slice_size=300)
    return write_busy_stream(path, FRAME + 2, small_layout(2, (400, 300, 300), 0, 5))


@pytest.mark.parametrize("kind", ["whole slices, SH 1", "slots that last"])
def test_a_picture(page: Page, tmp_path: Path, kind: str) -> None:
    stream = made_stream(tmp_path / "stream", kind)
    reader = StreamReader(stream)
    camera = reader.manifest.camera().resized(320, 240)
    [picture] = drawn(page, tmp_path, stream, [camera])
    splats = reader.active_splats(FRAME, reader.manifest.num_layers)
    expected = render_splats(splats, camera, reader.manifest.near_m).clip(0, 1)
    assert expected.mean() > 0.05
    assert psnr_db(picture, expected) >= LEAST_PSNR_DB


def test_what_is_behind_a_camera_that_has_just_turned(page: Page, tmp_path: Path) -> None:
    """Such Gaussians are still in the previous order, and do not show."""
    stream = made_stream(tmp_path / "stream", "slots that last")
    camera = StreamReader(stream).manifest.camera()
    away = replace(camera, w2c=np.diag([-1.0, 1.0, -1.0, 1.0]) @ camera.w2c)
    [picture] = drawn(page, tmp_path, stream, [away], ordered=camera.w2c.ravel().tolist())
    assert picture.max() == 0


@pytest.mark.parametrize("sh_degree", [2, 3])
@pytest.mark.parametrize("kind", ["floats", "on the lattice"])
def test_every_degree_is_drawn(page: Page, tmp_path: Path, sh_degree: int, kind: str) -> None:
    """Seen from 8 places, after a few frames whose changes have their own colours."""
    stream = tmp_path / "stream"
    wide: dict[str, Any] = {"near_m": 0.2}
    if kind == "floats":
        write_stream(stream, FRAME + 2, 30, sh_degree, **wide)
    else:
        write_busy_stream(stream, FRAME + 2, small_layout(2, (40, 30, 30), sh_degree, 5), **wide)
    reader = StreamReader(stream)
    splats = reader.active_splats(FRAME, reader.manifest.num_layers)
    assert splats.sh_degree == sh_degree
    middle = splats.means.mean(axis=0, dtype=np.float64)
    cameras = []
    for camera in cameras_all_round(8):
        w2c = camera.w2c.copy()
        w2c[:3, 3] += (0, 0, 2) - w2c[:3, :3] @ middle
        cameras.append(replace(camera, w2c=w2c).resized(64, 48))
    pictures = drawn(page, tmp_path, stream, cameras, first=FRAME - 3)
    for picture, camera in zip(pictures, cameras, strict=True):
        assert drawn_psnr_db(picture, splats, camera, most=1.0) >= LEAST_PSNR_DB


@pytest.mark.parametrize("sh_degree", [0, 1, 2, 3])
def test_between_two_frames(page: Page, tmp_path: Path, sh_degree: int) -> None:
    """Gaussians that move, jump, end, begin or are replaced are drawn as on the CPU."""
    layout = small_layout(1, (500, 300), sh_degree, 5)
    stream = write_moving_stream(tmp_path / "stream", FRAME + 2, layout)
    reader = StreamReader(stream)
    near_m, layers = reader.manifest.near_m, reader.manifest.num_layers
    camera = reader.manifest.camera().resized(320, 240)
    motion = reader.motion(FRAME - 1, FRAME, layers)
    assert 0.3 < (~motion.enters).mean() < 1
    assert len(motion.left) > 10
    assert motion.enters.sum() > 10
    shares = [0.0, 0.25, 0.5, 0.75, 1.0]
    pictures = drawn(page, tmp_path, stream, [camera], first=FRAME - 2, shares=shares)
    expected = [render_splats(motion.all_at(s), camera, near_m).clip(0, 1) for s in shares]
    assert psnr_db(expected[0], expected[-1]) < 30
    found_db = [psnr_db(a, b) for a, b in zip(pictures, expected, strict=True)]
    assert found_db[2] >= LEAST_HALF_WAY_DB, found_db
    assert min(found_db) >= LEAST_BETWEEN_DB, found_db
    assert found_db[-1] >= LEAST_PSNR_DB, found_db


def test_no_gaussian_jumps_and_comes_back(page: Page, tmp_path: Path) -> None:
    """A Gaussian that jumps, and one whose slot gets another, fade out in place while their
    successors fade in; between the places nothing shows at any time."""
    places_m = np.array([[-1, -0.6, 4], [1, -0.6, 4], [0, 0, 4], [-1, 0.6, 4], [1, 0.6, 4]])
    stream = write_jumps(tmp_path / "stream", FRAME + 1, FRAME, places_m.astype(np.float32))
    reader = StreamReader(stream)
    camera = reader.manifest.camera().resized(320, 240)
    splats = reader.active_splats(FRAME - 1, 1), reader.active_splats(FRAME, 1)
    before, after = (render_splats(s, camera, reader.manifest.near_m).clip(0, 1) for s in splats)
    shares = [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]
    pictures = drawn(page, tmp_path, stream, [camera], first=FRAME - 2, shares=shares)
    shown = np.maximum(before, after).max(axis=2) > 0
    assert 0.01 < shown.mean() < 0.5
    ends, begins = (one.max(axis=2) > 0.1 for one in (before - after, after - before))
    assert min(ends.sum(), begins.sum()) > 100
    for share, picture in zip(shares, pictures, strict=True):
        assert picture[~shown].max() < 2 / 255
        part = picture[ends].sum() / before[ends].sum(), picture[begins].sum() / after[begins].sum()
        assert part == pytest.approx((1 - share, share), abs=0.06)
        stays = before[110:130, 150:170]
        assert np.abs(picture[110:130, 150:170] - stays).max() < 3 / 255


def drawn(
    page: Page, tmp_path: Path, stream: Path, cameras: list[Camera], **more: object
) -> list[Doubles]:
    """(height, width, 3) pictures of FRAME by the browser for each of `cameras`, of one size, and
    for each of the shares."""
    (tmp_path / "player").symlink_to(ROOT / "player")  # render.html takes a picture apart
    (tmp_path / "render.html").write_bytes((SCRIPTS / "render.html").read_bytes())
    export_static(stream, tmp_path / "static")
    with static_host(tmp_path) as url:
        page.open(f"{url}/render.html")
        page.wait("window.renderFrame !== undefined")
        places = [for_browser(camera) for camera in cameras]
        value = {"base": f"{url}/static/", "frame": FRAME, "cameras": places, **more}
        found = page.run("return window.renderFrame(value)", value)
    shape = (cameras[0].height_px, cameras[0].width_px, 4)
    pixels = [np.frombuffer(base64.b64decode(text), np.uint8) for text in found["pictures"]]
    return [one.reshape(shape)[..., :3] / 255 for one in pixels]


def for_browser(camera: Camera) -> dict[str, object]:
    names = ["name", "width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px"]
    return {**fields_in_browser(camera, names), "w2c": camera.w2c.ravel().tolist()}


PROGRAMS = SCRIPTS / "programs.js"

NUM_PROGRAMS = {1: 7, 3: 8}
"""By degree of the harmonics: splats, depths, the screen, two that expand what arrives, two that
draw between frames, and from degree 2 on one for colours."""


@pytest.mark.parametrize("sh_degree", NUM_PROGRAMS)
def test_every_program_compiles_without_a_word(page: Page, tmp_path: Path, sh_degree: int) -> None:
    """Those of the bundle, which is what viewers get."""
    layout = small_layout(1, (60, 40), sh_degree, 4)
    write_moving_stream(tmp_path / "stream", 60, layout)
    export_static(tmp_path / "stream", tmp_path / "static")
    with player_host(tmp_path) as url:
        watch(page, f"{url}/player/watch.html?src=../static&autoplay=0", scripts=(PROGRAMS,))
        page.wait("player.motion !== null")
        click = "new MouseEvent('dblclick', { altKey: true, clientX: 80 })"
        page.run(f"player.canvas.dispatchEvent({click})")
        page.run("element.playbackRate = 0.1; element.play()")
        page.wait(f"window.numPrograms() >= {NUM_PROGRAMS[sh_degree]}")
        found = page.run("return window.complaintsOfPrograms()")
        assert found == [""] * NUM_PROGRAMS[sh_degree]
        page.wait("player.renderer.inbetween !== null")
