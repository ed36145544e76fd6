"""Held-out cameras: those of held_out.txt in every layout, or one between the others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from codec.camera import Camera
from codec.pose import look_at
from tests.support.tiny_capture import tiny_rig, write_dynamic3dgs, write_dynerf
from tests.support.tiny_models import transforms_of, write_model, write_pictures, write_transforms
from trainer.capture.held_out import camera_between, read_held_out
from trainer.capture.layout import open_capture
from trainer.errors import CaptureError


def write_colmap(root: Path) -> None:
    cameras = tiny_rig(3)
    write_model(root / "sparse", cameras, [f"{c.name}.png" for c in cameras], True)
    write_pictures(root, cameras, 1, True)


def write_nerfstudio(root: Path) -> None:
    cameras = tiny_rig(3)
    write_transforms(root, transforms_of(cameras, write_pictures(root, cameras, 1, True)))


@pytest.mark.parametrize("write", [write_dynerf, write_colmap, write_nerfstudio, write_dynamic3dgs])
def test_every_layout_reads_it_alike(tmp_path: Path, write: Callable[[Path], object]) -> None:
    root = tmp_path / "c"
    write(root)
    assert open_capture(root).held_out == (1,)  # the middle one of three on an arc
    for text, expected in (("", ()), ("cam01", (1,)), ("cam02\r\n\n cam00 \n", (0, 2))):
        (root / "held_out.txt").write_text(text)
        assert open_capture(root).held_out == expected
    for data, said in ((b"cam07", "'cam07' is not a camera of"), (b"\xff\xfe", "not text")):
        (root / "held_out.txt").write_bytes(data)
        with pytest.raises(CaptureError, match=f"held_out.txt: {said}"):
            open_capture(root)


def test_without_the_file_it_is_the_one_between(tmp_path: Path) -> None:
    assert read_held_out(tmp_path, tiny_rig(5)) == {"cam02"}
    assert read_held_out(tmp_path, tiny_rig(1)) == {"cam00"}
    assert read_held_out(tmp_path, []) == set()


def standing_at(places: Sequence[Sequence[float]]) -> list[Camera]:
    """Cameras at these places that look at one point."""
    return [
        Camera(
            f"cam{i:02d}", 64, 36, 50.0, 50.0, 32.0, 18.0,
            look_at(np.array(place, float), np.array([0.1, 0.2, 5.3]), np.array([0.0, -1.0, 0.01])),
        )
        for i, place in enumerate(places)
    ]  # fmt: skip


@pytest.mark.parametrize("arc_deg", [20, 90, 160, 200, 240])
@pytest.mark.parametrize("count", range(4, 25))
def test_never_the_end_of_an_arc(count: int, arc_deg: float) -> None:
    cameras = tiny_rig(count, arc_deg)
    found = camera_between(cameras)
    assert 0 < found < count - 1
    # For any order of the files, it is in the middle third of the arc.
    order = np.random.default_rng(count).permutation(count)
    place = order[camera_between([cameras[i] for i in order])]
    assert (count - 1) / 4 <= place <= 3 * (count - 1) / 4


def test_never_the_corner_or_edge_of_a_grid() -> None:
    grid = [(x, y, 0.0) for y in range(4) for x in range(5)]
    assert camera_between(standing_at(grid)) in (7, 12)


def test_of_a_ring_and_a_camera_far_above_it_is_one_of_the_ring() -> None:
    angles = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    ring = [(3 * np.cos(a), 0.0, 3 * np.sin(a)) for a in angles]
    assert camera_between(standing_at([(0.0, -0.8, 0.0), *ring])) == 1


def test_twins_do_not_make_an_end_a_middle() -> None:
    pairs = [(x + e, 0.0, 0.0) for x in range(6) for e in (0.0, 0.05)]
    assert 2 <= camera_between(standing_at(pairs)) <= 9


def test_where_none_stands_between_it_is_the_nearest_to_it() -> None:
    triangle = [(0.0, 0.0, 0.0), (2.0, 0.0, 0.0), (1.0, 0.8, 0.0)]
    assert camera_between(standing_at(triangle)) == 2
    assert camera_between(standing_at([(1.0, 0.0, 0.0)] * 3)) == 0


def test_another_unit_or_frame_of_the_world_chooses_alike() -> None:
    rng = np.random.default_rng(5)
    places = rng.normal(size=(30, 3))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    expected = camera_between(standing_at(places.tolist()))
    assert camera_between(standing_at((1e-3 * places @ turn + 7).tolist())) == expected
