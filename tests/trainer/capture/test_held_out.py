"""Held-out cameras of every layout; and place and depth of the scene, from cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from codec.camera import Camera, look_at
from codec.rig import rig_centre, rig_depths
from tests.support.hostile import refused
from tests.support.tiny_capture import refusal, tiny_rig
from tests.trainer.capture.test_masks import LAYOUTS, write_layout
from trainer.capture.capture import CameraChoice, camera_between, read_held_out
from trainer.capture.layout import open_capture
from trainer.errors import CaptureError
from trainer.synth.scene import CAMERA_RADIUS_M, CAMERA_TARGET


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_reads_it_alike(tmp_path: Path, layout: str) -> None:
    root = tmp_path / "c"
    write_layout(root, layout)
    assert open_capture(root).held_out == (1,)  # the middle one of three on an arc, or as declared
    for text, expected in (("", ()), ("cam01", (1,)), ("cam02\r\n\n cam00 \n", (0, 2))):
        (root / "held_out.txt").write_text(text)
        capture = open_capture(root)
        assert capture.held_out == expected
        assert expected or capture.watching == capture.training
    (root / "held_out.txt").write_text("cam01 cam02")
    left = open_capture(root, CameraChoice(("cam02",)))  # which may be held out
    assert ("cam02" in [c.camera.name for c in left.cameras], left.held_out) == (False, (1,))
    says = "no camera 'cam9' to leave out; it has cam00, cam01"
    refused(CaptureError, says, open_capture, root, CameraChoice(("cam9",)))
    for data, said in ((b"cam07", "'cam07' is not a camera of"), (b"\xff\xfe", "not text")):
        (root / "held_out.txt").write_bytes(data)
        assert f"held_out.txt: {said}" in refusal(root)
    if layout == "dynamic3dgs":  # without the list of the cameras that are held out
        for name in ("held_out.txt", "test_meta.json", "fps.txt"):
            (root / name).unlink()
        capture = open_capture(root)
        assert (capture.held_out, capture.fps) == ((1,), None)


def standing_at(places: Sequence[Sequence[float]]) -> list[Camera]:
    """Cameras at these places that look at one point."""
    return [
        Camera(
            f"cam{i:02d}", 64, 36, 50.0, 50.0, 32.0, 18.0,
            look_at(np.array(place, float), np.array([0.1, 0.2, 5.3]), np.array([0.0, -1.0, 0.01])),
        )
        for i, place in enumerate(places)
    ]  # fmt: skip


def test_never_the_end_of_an_arc() -> None:
    for arc_deg, count in product((20, 90, 160, 200, 240), range(4, 25)):
        cameras = tiny_rig(count, arc_deg)
        assert 0 < camera_between(cameras) < count - 1
        # For any order of the files, it is in the middle third of the arc.
        order = np.random.default_rng(count).permutation(count)
        place = order[camera_between([cameras[i] for i in order])]
        assert (count - 1) / 4 <= place <= 3 * (count - 1) / 4, (arc_deg, count)


def test_never_the_corner_or_edge_of_a_grid_nor_what_is_far_above_a_ring() -> None:
    grid = [(x, y, 0.0) for y in range(4) for x in range(5)]
    assert camera_between(standing_at(grid)) in (7, 12)
    angles = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    ring = [(3 * np.cos(a), 0.0, 3 * np.sin(a)) for a in angles]
    assert camera_between(standing_at([(0.0, -0.8, 0.0), *ring])) == 1
    # Twins do not make an end a middle.
    pairs = [(x + e, 0.0, 0.0) for x in range(6) for e in (0.0, 0.05)]
    assert 2 <= camera_between(standing_at(pairs)) <= 9


def test_the_one_between_in_small_rigs_and_in_another_unit_or_frame(tmp_path: Path) -> None:
    assert read_held_out(tmp_path, tiny_rig(5)) == {"cam02"}
    assert read_held_out(tmp_path, tiny_rig(1)) == {"cam00"}
    assert read_held_out(tmp_path, []) == set()
    # Where none stands between, it is the nearest to it.
    triangle = [(0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (1.0, 0.8, 0.0)]
    assert camera_between(standing_at(triangle)) == 2
    assert camera_between(standing_at([(1.0, 0.0, 0.0)] * 3)) == 0
    rng = np.random.default_rng(5)
    places = rng.normal(size=(30, 3))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    expected = camera_between(standing_at(places.tolist()))
    assert camera_between(standing_at((1e-3 * places @ turn + 7).tolist())) == expected


def test_rig_depths_of_an_inward_rig() -> None:
    cameras = tiny_rig(9)
    centre = rig_centre(cameras)
    assert centre is not None
    assert np.allclose(centre, CAMERA_TARGET, atol=1e-9)
    depths = rig_depths(cameras, (0.1, 99.0))
    assert depths is not None
    distances = [float(np.linalg.norm(c.position - centre)) for c in cameras]
    assert depths[0] == pytest.approx(0.35 * min(distances))
    assert depths[1] >= 2 * max(distances) - 1e-9
    assert depths[1] >= 1.2 * 2 * CAMERA_RADIUS_M * np.sin(np.radians(79))


def test_rigs_without_a_centre_have_the_depths_that_they_declare() -> None:
    forward = tiny_rig(6, arc_deg=20)
    assert rig_centre(forward) is None
    assert rig_depths(forward, (1.2, 34.0)) == (1.2, 34.0)
    assert rig_depths(forward) is rig_depths(forward[:1]) is rig_depths([]) is None
    cameras, around = tiny_rig(9), np.diag([-1.0, 1.0, -1.0, 1.0])
    away = replace(cameras[8], w2c=around @ cameras[8].w2c)
    assert rig_centre([*cameras[:8], away]) is None

    def camera(x_m: float, z_m: float) -> Camera:
        pose = look_at(np.array([x_m, 0, z_m]), np.zeros(3), np.array([0.0, -1, 0]))
        return Camera("c", 64, 36, 50.0, 50.0, 32.0, 18.0, pose)

    # Facing each other along one line.
    assert rig_centre([camera(0, -3), camera(0, 3)]) is None
    off_line = rig_centre([camera(0, -3), camera(0, 3), camera(0.1, 3)])
    assert off_line is not None
    np.testing.assert_allclose(off_line, np.zeros(3), atol=1e-9)
