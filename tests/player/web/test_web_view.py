"""The camera in the browser turns, moves and zooms like in the window of swings-play."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from codec.stream.manifest import Manifest, Point
from codec.stream.views import view_from_text
from player.view.mouse import view_of
from tests.support.hosted_streams import small_manifest
from tests.support.web.browsercode import BrowserCode
from tests.support.web.nodeprocess import Json

MOVES: tuple[tuple[str, tuple[float, ...]], ...] = (
    ("turn", (120.0, -30.0)),
    ("zoom", (3.0,)),
    ("pan", (40.0, 25.0, 500.0)),
    ("turn", (-400.0, 900.0)),
    ("zoom", (-90.0,)),
)


def outward() -> Manifest:
    """Cameras that look away from each other, so that they have no common point."""
    made = small_manifest()
    turn = np.diag([-1.0, 1.0, -1.0, 1.0])
    return replace(made, cameras=tuple(replace(c, w2c=turn @ c.w2c) for c in made.cameras))


def moved(
    browser: BrowserCode, manifest: Manifest, width_px: int, height_px: int, **how: object
) -> Json:
    size = {"widthPx": width_px, "heightPx": height_px}
    return browser.ask("moved", manifest=manifest.to_json().hex(), **size, **how)


@pytest.mark.parametrize("manifest", [small_manifest(), outward()], ids=["inward", "outward"])
@pytest.mark.parametrize("again", [False, True], ids=["moved", "by a link"])
def test_the_camera(browser: BrowserCode, manifest: Manifest, again: bool) -> None:
    view = view_of(manifest)
    actions: dict[str, Callable[..., None]] = {
        "turn": view.drag_turn,
        "pan": view.drag_pan,
        "zoom": lambda steps: view.scroll(0, steps),
    }
    for count, (name, arguments) in enumerate(MOVES, 1):
        actions[name](*arguments)
        expected = view.applied(manifest.camera().fitted(390, 844))
        moves = [[name, *arguments] for name, arguments in MOVES[:count]]
        found = moved(browser, manifest, 390, 844, moves=moves, again=again)
        w2c = np.array(found["w2c"]).reshape(4, 4)
        scale = 2e-3 * max(1, float(np.abs(expected.w2c).max()))
        np.testing.assert_allclose(w2c, expected.w2c, atol=scale if again else 1e-9)
        same = view_from_text(found["text"], manifest)
        np.testing.assert_allclose(same.w2c, expected.w2c, atol=scale)
        # The portrait picture of a phone is four thirds as high as the view.
        camera = manifest.camera()
        assert found["fxPx"] == pytest.approx(camera.fx_px * 844 / camera.height_px * 3 / 4)
        assert found["cxPx"] == pytest.approx(195)
        assert found["cyPx"] == pytest.approx(844 / 4 / 4 + camera.cy_px * 844 / 48 * 3 / 4)


@pytest.mark.parametrize(
    ("width_px", "x_m", "focus", "shown"),
    [
        (128, 0.0, None, (2, 64)),
        (200, 0.5, None, (2, 100)),
        (98, 0.0, None, (1.75, 49)),
        (60, 0.0, None, (1.5, 30)),
        (60, -0.5, None, (1.5, 41.25)),
        (60, 3.0, None, (1.5, 12)),
        (60, 3.0, (-0.5, 1.0, 4.0), (1.5, 41.25)),
    ],
    ids=["the same shape", "wider", "halfway", "narrow", "beside", "at the edge", "what moves"],
)
def test_a_narrow_picture_shows_what_the_rig_looks_at_or_what_moves(
    browser: BrowserCode, width_px: int, x_m: float, focus: Point | None, shown: tuple[float, float]
) -> None:
    """x_m: place of the scene's centre, 4 m ahead. The camera's pictures have 64x48 pixels."""
    scale, middle_px = shown
    made = small_manifest()
    camera = replace(made.cameras[0], w2c=np.eye(4))
    bounds = ((x_m - 2, -2.0, 2.0), (x_m + 2, 2.0, 6.0))
    manifest = replace(made, cameras=(camera,), bounds=bounds, focus=focus)
    found = moved(browser, manifest, width_px, 96, moves=[], again=False)
    assert found["fxPx"] == pytest.approx(scale * camera.fx_px)
    assert found["cxPx"] == pytest.approx(middle_px)
    assert found["cyPx"] == pytest.approx(24 * scale + (96 - 48 * scale) / 4)


@pytest.mark.parametrize("own", [(), (0.2, 0.5, 0.9, 0.1)], ids=["one for all", "of cameras"])
def test_near_planes_are_those_of_python(browser: BrowserCode, own: tuple[float, ...]) -> None:
    manifest = small_manifest(camera_near_m=own)
    rng = np.random.default_rng(0)
    views = list(manifest.cameras)
    for camera in manifest.cameras:
        for step_m in (0.05, 0.2, 0.6):
            w2c = camera.w2c.copy()
            w2c[:3, 3] += rng.normal(0, step_m, 3)
            views.append(replace(camera, w2c=w2c))
    poses = [view.w2c.ravel().tolist() for view in views]
    found = browser.ask("nearPlanes", manifest=manifest.to_json().hex(), poses=poses)
    assert found == pytest.approx([manifest.near_of(view) for view in views])
    assert tuple(found[:4]) == pytest.approx(own or (manifest.near_m,) * 4)
