"""held_out.txt means the same in every layout that has it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.tiny_capture import tiny_rig, write_dynerf
from tests.support.tiny_models import transforms_of, write_model, write_pictures, write_transforms
from trainer.capture.held_out import read_held_out
from trainer.capture.layout import open_capture
from trainer.errors import CaptureError


def write_colmap(root: Path) -> None:
    cameras = tiny_rig(3)
    write_model(root / "sparse", cameras, [f"{c.name}.png" for c in cameras], True)
    write_pictures(root, cameras, 1, True)


def write_nerfstudio(root: Path) -> None:
    cameras = tiny_rig(3)
    write_transforms(root, transforms_of(cameras, write_pictures(root, cameras, 1, True)))


@pytest.mark.parametrize("write", [write_dynerf, write_colmap, write_nerfstudio])
def test_every_layout_reads_it_alike(tmp_path: Path, write: Callable[[Path], object]) -> None:
    root = tmp_path / "c"
    write(root)
    assert open_capture(root).held_out == (0,)
    for text, expected in (("", ()), ("cam01", (1,)), ("cam02\r\n\n cam00 \n", (0, 2))):
        (root / "held_out.txt").write_text(text)
        assert open_capture(root).held_out == expected
    for data, said in ((b"cam07", "'cam07' is not a camera of"), (b"\xff\xfe", "not text")):
        (root / "held_out.txt").write_bytes(data)
        with pytest.raises(CaptureError, match=f"held_out.txt: {said}"):
            open_capture(root)


def test_without_the_file_the_first_camera_is_held_out(tmp_path: Path) -> None:
    assert read_held_out(tmp_path, ["b", "a"]) == {"b"}
    assert read_held_out(tmp_path, []) == set()
