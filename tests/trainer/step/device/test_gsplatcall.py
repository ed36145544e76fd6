"""Our call of gsplat fits the pinned version, whose signature is recorded here.

If gsplat is installed, the record is compared with it, and our projection with its own reference,
which needs no GPU.
"""

from __future__ import annotations

import inspect
from dataclasses import replace
from inspect import Parameter, Signature
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from codec.camera import Camera
from player.render.project import LOW_PASS_PX2
from tests.support.reference_render import turned_camera
from trainer.step.device.backends import gsplat_picture, reached_tiles
from trainer.step.device.tensors import Crossing, DeviceView
from trainer.step.device.torchrender import CONIC_A, CONIC_C, Solids, X, Y, project, rotations
from trainer.step.raster import View

VERSION = "1.5.3"
NEEDED = (
    "means", "quats", "scales", "opacities", "colors", "viewmats", "Ks", "width", "height",
)  # fmt: skip
"""Parameters of gsplat.rasterization without a default, in order."""
OPTIONS = {
    "near_plane": 0.01, "far_plane": 1e10, "radius_clip": 0.0, "eps2d": 0.3, "sh_degree": None,
    "packed": True, "tile_size": 16, "backgrounds": None, "render_mode": "RGB",
    "sparse_grad": False, "absgrad": False, "rasterize_mode": "classic", "channel_chunk": 32,
    "distributed": False, "camera_model": "pinhole", "segmented": False, "covars": None,
    "with_ut": False, "with_eval3d": False,
}  # fmt: skip
"""Other relevant parameters, with their defaults. The following ones are about lenses."""
COUNT = 40


def recorded() -> Signature:
    kind = Parameter.POSITIONAL_OR_KEYWORD
    parameters = [Parameter(name, kind) for name in NEEDED]
    parameters += [Parameter(name, kind, default=value) for name, value in OPTIONS.items()]
    return Signature(parameters)


def solids() -> Solids:
    rng = np.random.default_rng(0)
    return Solids(
        torch.tensor(rng.uniform(-1, 1, (COUNT, 3)), dtype=torch.float32),
        torch.nn.functional.normalize(torch.tensor(rng.normal(size=(COUNT, 4))).float(), dim=1),
        torch.tensor(rng.uniform(0.02, 0.2, (COUNT, 3)), dtype=torch.float32),
        torch.full((COUNT,), 0.7),
        torch.tensor(rng.random((COUNT, 3)), dtype=torch.float32),
    )


def view_of(camera: Camera) -> DeviceView:
    return DeviceView.send(View.prepare(camera, 0.2), Crossing(torch.device("cpu")))


def test_the_call_binds_and_has_the_shapes_that_gsplat_documents() -> None:
    calls: list[dict[str, Any]] = []

    def rasterization(**given: Any) -> tuple[Tensor, Tensor, dict[str, Any]]:
        calls.append(given)
        return torch.zeros(1, given["height"], given["width"], 3), torch.zeros(1), {}

    camera = turned_camera()
    raster = gsplat_picture(solids(), view_of(camera), COUNT, True, rasterization)
    assert raster.picture.shape == (3, camera.height_px, camera.width_px)
    (given,) = calls
    bound = recorded().bind(**given)  # raises TypeError for a name that gsplat does not have
    bound.apply_defaults()
    shapes = {name: tuple(v.shape) for name, v in bound.arguments.items() if isinstance(v, Tensor)}
    assert shapes == {
        "means": (COUNT, 3), "quats": (COUNT, 4), "scales": (COUNT, 3), "opacities": (COUNT,),
        "colors": (COUNT, 3), "viewmats": (1, 4, 4), "Ks": (1, 3, 3),
    }  # fmt: skip
    assert all(v.dtype == torch.float32 for v in given.values() if isinstance(v, Tensor))
    # Colours are those that the camera sees, on black.
    assert (bound.arguments["sh_degree"], bound.arguments["backgrounds"]) == (None, None)
    assert bound.arguments["render_mode"] == "RGB"


def test_the_tiles_of_boxes_are_those_that_they_touch() -> None:
    rng, view = np.random.default_rng(3), view_of(turned_camera().resized(200, 120))
    for count in (0, 1, 3):
        centres = rng.uniform((-40, -40), (240, 160), (count, 2))
        radii = rng.integers(0, 30, (count, 2))
        shows = (radii > 0).all(axis=1)
        expected = np.zeros((view.tiles_y, view.tiles_x), bool)
        for (x, y), (rx, ry) in zip(centres[shows], radii[shows], strict=True):
            for row, column in np.ndindex(expected.shape):
                touches = column * 16 <= x + rx and x - rx < column * 16 + 16
                expected[row, column] |= touches and row * 16 <= y + ry and y - ry < row * 16 + 16
        centres[~shows] = np.nan  # gsplat leaves the old content there
        found = reached_tiles(torch.tensor(centres).float(), torch.tensor(radii).int(), view)
        assert np.array_equal(found.numpy(), expected)


def test_where_not_all_is_compared_its_boxes_say_which_tiles_matter() -> None:
    given, view = solids(), view_of(turned_camera())
    drawn = project(given, view)
    centres, radii = torch.zeros(1, COUNT, 2), torch.zeros(1, COUNT, 2, dtype=torch.int32)
    centres[0, drawn.rows] = drawn.values[:, [X, Y]]
    radii[0, drawn.rows] = 5

    def rasterization(**asked: Any) -> tuple[Tensor, Tensor, dict[str, Any]]:
        picture = torch.zeros(1, asked["height"], asked["width"], 3)
        return picture, torch.zeros(1), {"means2d": centres, "radii": radii}

    assert gsplat_picture(given, view, COUNT, True, rasterization).active is None
    some = gsplat_picture(given, view, 2, False, rasterization).active
    every = gsplat_picture(given, view, COUNT, False, rasterization).active
    assert some is not None
    assert every is not None
    assert 0 < some.sum() < every.sum()
    assert torch.equal(some & every, some)


def test_the_pinned_version_is_the_recorded_one() -> None:
    root = Path(__file__).parents[4]
    lines = (root / "constraints.txt").read_text(encoding="utf-8").splitlines()
    assert f"gsplat=={VERSION}" in lines


def test_the_record_is_that_of_gsplat() -> None:
    gsplat = pytest.importorskip("gsplat", reason="gsplat is not installed")
    found = inspect.signature(gsplat.rasterization).parameters
    needed = [name for name, p in found.items() if p.default is Parameter.empty]
    assert tuple(needed) == NEEDED
    assert {name: p.default for name, p in found.items() if name in OPTIONS} == OPTIONS
    others = set(found) - set(NEEDED) - set(OPTIONS)
    assert all(found[name].default is not Parameter.empty for name in others)


def test_our_projection_is_that_of_gsplats_own_reference() -> None:
    reference = pytest.importorskip("gsplat.cuda._torch_impl", reason="gsplat is not installed")
    # Outside the picture gsplat's clamp depends on the principal point, ours does not.
    camera = turned_camera()
    camera = replace(camera, cx_px=camera.width_px / 2, cy_px=camera.height_px / 2)
    given, view = solids(), view_of(camera)
    halves = rotations(given.quats) * given.scales[:, None, :]
    _, centres, depths, conics, _ = reference._fully_fused_projection(
        given.means, halves @ halves.transpose(1, 2), view.w2c[None], view.intrinsics[None],
        view.camera.width_px, view.camera.height_px, LOW_PASS_PX2, view.near_m,
    )  # fmt: skip
    drawn = project(given, view).values
    assert len(drawn) > COUNT // 2
    # Our list has the visible ones, nearest first.
    order = torch.argsort(depths[0], stable=True)
    theirs = torch.cat([centres[0], conics[0]], 1)[order]
    apart = torch.cdist(drawn[:, [X, Y]], theirs[:, :2])
    nearest = apart.argmin(1)
    assert (nearest.diff() > 0).all()
    np.testing.assert_allclose(
        drawn[:, X : CONIC_C + 1].numpy(), theirs[nearest].numpy(), rtol=2e-3, atol=1e-4
    )
    assert CONIC_A == X + 2
