"""The picture of the browser is that of the CPU renderer."""

from __future__ import annotations

import base64
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from codec.camera import Camera
from codec.stream.reader import StreamReader
from codec.tools.static import export_static
from player.render.cpu import render_splats
from tests.support.hosted_streams import static_host, write_stream
from tests.support.reference_render import cameras_all_round, drawn_psnr_db
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout
from tests.support.web.browsercamera import for_browser
from tests.support.web.canvas import LEAST_PSNR_DB, psnr_db
from tests.support.web.chromium import Page

ROOT = Path(__file__).parents[3]
FRAME = 7


def made_stream(path: Path, kind: str) -> Path:
    match kind:
        case "whole slices, SH 1":
            return write_stream(path, FRAME + 2, slice_size=300)
        case _:
            layout = small_layout(2, (400, 300, 300), 0, 5)
            return write_busy_stream(path, FRAME + 2, layout)


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
    """It is still in the order of before, and does not show."""
    stream = made_stream(tmp_path / "stream", "slots that last")
    camera = StreamReader(stream).manifest.camera()
    away = replace(camera, w2c=np.diag([-1.0, 1.0, -1.0, 1.0]) @ camera.w2c)
    [picture] = drawn(page, tmp_path, stream, [away], ordered=camera.w2c.ravel().tolist())
    assert picture.max() == 0


@pytest.mark.parametrize("sh_degree", [2, 3])
@pytest.mark.parametrize("kind", ["floats", "on the lattice"])
def test_every_degree_is_drawn(page: Page, tmp_path: Path, sh_degree: int, kind: str) -> None:
    """From 8 places, after a few frames whose changes have colours of their own."""
    stream, wide = tmp_path / "stream", {"near_m": 0.2}
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


def drawn(
    page: Page, tmp_path: Path, stream: Path, cameras: list[Camera], **more: object
) -> list[npt.NDArray[np.float64]]:
    """(height, width, 3) what the browser draws of FRAME for each of `cameras`, of one size."""
    (tmp_path / "player").symlink_to(ROOT / "player")
    (tmp_path / "render.html").write_bytes((Path(__file__).parent / "render.html").read_bytes())
    export_static(stream, tmp_path / "static")
    with static_host(tmp_path) as url:
        page.open(f"{url}/render.html")
        page.wait("window.renderFrame !== undefined")
        places = [for_browser(camera) for camera in cameras]
        value = {"base": f"{url}/static/", "frame": FRAME, "cameras": places, **more}
        found = page.run("return window.renderFrame(value)", value)
    assert not page.complaints
    shape = (cameras[0].height_px, cameras[0].width_px, 4)
    pixels = [np.frombuffer(base64.b64decode(text), np.uint8) for text in found["pictures"]]
    return [one.reshape(shape)[..., :3] / 255 for one in pixels]
