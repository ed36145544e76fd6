"""The picture of the browser is that of the CPU renderer."""

from __future__ import annotations

import base64
from pathlib import Path

import numpy as np
import pytest

from codec.camera import Camera
from codec.profiles.profile import Profile
from codec.stream.reader import StreamReader
from codec.tools.static import export_static
from player.render.cpu import render_splats
from tests.support.hosted_streams import static_host, write_stream
from tests.support.slots.slot_streams import write_busy_stream
from tests.support.slots.updates import small_layout
from tests.support.web.chromium import Page

ROOT = Path(__file__).parents[3]
FRAME = 7
LEAST_PSNR_DB = 45.0


def camera_for_browser(camera: Camera) -> dict[str, object]:
    return {
        "name": camera.name,
        "widthPx": camera.width_px,
        "heightPx": camera.height_px,
        "fxPx": camera.fx_px,
        "fyPx": camera.fy_px,
        "cxPx": camera.cx_px,
        "cyPx": camera.cy_px,
        "w2c": camera.w2c.ravel().tolist(),
    }


def made_stream(path: Path, kind: str) -> Path:
    match kind:
        case "version 1, SH 1":
            return write_stream(path, FRAME + 2, slice_size=300)
        case "version 1, compact":
            return write_stream(path, FRAME + 2, 300, 0, profile=Profile.COMPACT)
        case _:
            layout = small_layout(2, (400, 300, 300), 0, 5)
            return write_busy_stream(path, FRAME + 2, layout)


@pytest.mark.parametrize("kind", ["version 1, SH 1", "version 1, compact", "version 2"])
def test_a_picture(page: Page, tmp_path: Path, kind: str) -> None:
    stream = made_stream(tmp_path / "stream", kind)
    (tmp_path / "player").symlink_to(ROOT / "player")
    (tmp_path / "render.html").write_bytes((Path(__file__).parent / "render.html").read_bytes())
    export_static(stream, tmp_path / "static")
    reader = StreamReader(stream)
    camera = reader.manifest.camera().resized(320, 240)
    with static_host(tmp_path) as url:
        page.open(f"{url}/render.html")
        page.wait("window.renderFrame !== undefined")
        value = {
            "base": f"{url}/static/",
            "frame": FRAME,
            "camera": camera_for_browser(camera),
        }
        found = page.run("return window.renderFrame(value)", value)
    assert not page.complaints
    pixels = np.frombuffer(base64.b64decode(found["pixels"]), np.uint8).reshape(240, 320, 4)
    splats = reader.active_splats(FRAME, reader.manifest.num_layers)
    expected = render_splats(splats, camera, reader.manifest.near_m).clip(0, 1)
    assert expected.mean() > 0.05
    error = pixels[..., :3] / 255 - expected
    psnr_db = -10 * np.log10(np.mean(error**2))
    assert psnr_db >= LEAST_PSNR_DB
