"""The picture that the page has drawn, and the expected one."""

from __future__ import annotations

import base64

import numpy as np
import numpy.typing as npt

from codec.arrays import Doubles, Floats
from codec.camera import Camera
from codec.stream.reader import StreamReader
from player.render.cpu import render_splats
from tests.support.waiting import wait_until
from tests.support.web.chromium import Page
from tests.support.web.nodeprocess import SCRIPTS, Json

PIXELS = SCRIPTS / "pixels.js"
"""A script that runs in the page before the page's own scripts, and reads pixels."""

LEAST_PSNR_DB = 55.0
"""Minimum PSNR of the drawn picture against that of the CPU renderer."""


def picture_of(found: Json) -> Doubles:
    """(height, width, 3) picture in 0..1, the top row first."""
    pixels = np.frombuffer(base64.b64decode(found["pixels"]), np.uint8)
    upwards = pixels.reshape(found["heightPx"], found["widthPx"], 4)
    picture: Doubles = upwards[::-1, :, :3] / 255
    return picture


def canvas_of(page: Page) -> Doubles:
    """The picture on the canvas once it matches the current camera."""
    return picture_of(page.run("return window.readCanvas(player)"))


def held_picture_of(page: Page) -> Doubles:
    """What the canvas shows now."""
    return picture_of(page.run("return window.shownPixels(player.canvas)"))


def psnr_db(a: npt.NDArray[np.floating], b: npt.NDArray[np.floating]) -> float:
    return float(-10 * np.log10(np.mean((a - b) ** 2)))


def expected_of(
    reader: StreamReader, camera: Camera, frame: int = 0, layers: int | None = None
) -> Floats:
    splats = reader.active_splats(frame, layers or reader.manifest.num_layers)
    picture = render_splats(splats, camera, reader.manifest.near_m).clip(0, 1)
    assert picture.mean() > 0.03
    return picture


def check_picture(
    page: Page,
    reader: StreamReader,
    frame: int = 0,
    layers: int | None = None,
    camera: Camera | None = None,
) -> None:
    """Asserts that the canvas shows the CPU renderer's picture of a frame. camera: None for the
    stream's own."""
    found = canvas_of(page)
    camera = camera or reader.manifest.camera().fitted(found.shape[1], found.shape[0])
    assert psnr_db(found, expected_of(reader, camera, frame, layers)) >= LEAST_PSNR_DB


def wait_for_picture(page: Page, reader: StreamReader, frame: int, layers: int) -> None:
    """Waits until the canvas shows the CPU renderer's picture of a frame with so many layers, which
    may still arrive."""
    page.wait(f"player.shownFrame === {frame}")
    size = page.value("[player.canvas.width, player.canvas.height]")
    expected = expected_of(reader, reader.manifest.camera().fitted(*size), frame, layers)
    wait_until(lambda: psnr_db(canvas_of(page), expected) >= LEAST_PSNR_DB)


def camera_of(found: Json) -> Camera:
    """The camera from the form of the browser's."""
    size = (found["widthPx"], found["heightPx"])
    lens = (found["fxPx"], found["fyPx"], found["cxPx"], found["cyPx"])
    return Camera("found", *size, *lens, np.array(found["w2c"], np.float64).reshape(4, 4))
