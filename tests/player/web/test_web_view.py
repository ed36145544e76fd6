"""A person turns, moves and zooms the camera in the browser as in the window of swings-play."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from codec.stream.manifest import Manifest
from player.view.mouse import view_of
from tests.support.hosted_streams import small_manifest
from tests.support.web.browsercode import BrowserCode

MOVES: tuple[tuple[str, tuple[float, ...]], ...] = (
    ("turn", (120.0, -30.0)),
    ("zoom", (3.0,)),
    ("pan", (40.0, 25.0, 500.0)),
    ("turn", (-400.0, 900.0)),
    ("zoom", (-90.0,)),
)


def outward() -> Manifest:
    """Cameras that look away from each other, so that they see no point together."""
    made = small_manifest()
    turn = np.diag([-1.0, 1.0, -1.0, 1.0])
    return replace(made, cameras=tuple(replace(c, w2c=turn @ c.w2c) for c in made.cameras))


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
        found = browser.ask(
            "moved",
            manifest=manifest.to_json().hex(),
            widthPx=390,
            heightPx=844,
            moves=[[name, *arguments] for name, arguments in MOVES[:count]],
            again=again,
        )
        w2c = np.array(found["w2c"]).reshape(4, 4)
        scale = 2e-3 * max(1, float(np.abs(expected.w2c).max()))
        np.testing.assert_allclose(w2c, expected.w2c, atol=scale if again else 1e-9)
        # An upright picture is halfway, as factors go, to one that the view fills.
        camera = manifest.camera()
        factor = np.sqrt(844 / camera.height_px / (390 / camera.width_px))
        assert found["fxPx"] == pytest.approx(factor * expected.fx_px)
        assert found["cyPx"] - 422 == pytest.approx(factor * (expected.cy_px - 422))
