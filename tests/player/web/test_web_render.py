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
    picture = drawn(page, tmp_path, stream, camera)
    splats = reader.active_splats(FRAME, reader.manifest.num_layers)
    expected = render_splats(splats, camera, reader.manifest.near_m).clip(0, 1)
    assert expected.mean() > 0.05
    assert psnr_db(picture, expected) >= LEAST_PSNR_DB


def test_what_is_behind_a_camera_that_has_just_turned(page: Page, tmp_path: Path) -> None:
    """It is still in the order of before, and does not show."""
    stream = made_stream(tmp_path / "stream", "slots that last")
    camera = StreamReader(stream).manifest.camera()
    away = replace(camera, w2c=np.diag([-1.0, 1.0, -1.0, 1.0]) @ camera.w2c)
    picture = drawn(page, tmp_path, stream, away, ordered=camera.w2c.ravel().tolist())
    assert picture.max() == 0


def drawn(
    page: Page, tmp_path: Path, stream: Path, camera: Camera, **more: object
) -> npt.NDArray[np.float64]:
    """(height, width, 3) what the browser draws of FRAME."""
    (tmp_path / "player").symlink_to(ROOT / "player")
    (tmp_path / "render.html").write_bytes((Path(__file__).parent / "render.html").read_bytes())
    export_static(stream, tmp_path / "static")
    with static_host(tmp_path) as url:
        page.open(f"{url}/render.html")
        page.wait("window.renderFrame !== undefined")
        value = {"base": f"{url}/static/", "frame": FRAME, "camera": for_browser(camera), **more}
        found = page.run("return window.renderFrame(value)", value)
    assert not page.complaints
    pixels = np.frombuffer(base64.b64decode(found["pixels"]), np.uint8)
    picture: npt.NDArray[np.float64] = (
        pixels.reshape(camera.height_px, camera.width_px, 4)[..., :3] / 255
    )
    return picture
