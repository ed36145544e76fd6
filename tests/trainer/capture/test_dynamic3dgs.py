"""Opening captures: the Dynamic 3D Gaussians layout and refusals."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from codec.errors import InvalidError
from tests.support.hostile import refused
from tests.support.tiny_capture import picture_of, refusal, write_dynamic3dgs
from trainer.capture.layout import open_capture
from trainer.capture.layouts import TITLES
from trainer.errors import CaptureError


def test_folders_that_are_not_captures_are_refused(tmp_path: Path) -> None:
    assert "no such folder" in refusal(tmp_path / "nowhere")
    file = tmp_path / "file"
    file.touch()
    assert "not a folder" in refusal(file)
    (tmp_path / "empty").mkdir()
    assert "is empty" in refusal(tmp_path / "empty")
    said = refusal(tmp_path)
    assert all(f"({title})" in said for title in TITLES.values())
    for videos in (tmp_path / "a", tmp_path / "b/videos"):
        videos.mkdir(parents=True)
        for name in ("cam00.mp4", "b.MOV", "._b.MOV"):
            (videos / name).touch()
        said = refusal(tmp_path / videos.relative_to(tmp_path).parts[0])
        assert f"{videos}: 2 videos, but no poses of their cameras" in said
    assert "see 'From videos' in docs/CAPTURES.md" in said


def test_missing_files_are_named(tmp_path: Path) -> None:
    root = tmp_path / "c"
    write_dynamic3dgs(root)
    (root / "ims/2/000001.png").unlink()
    message = refusal(root)
    assert "ims/2/000001.png" in message
    assert "cam02 lacks frame 1" in message
    (root / "ims/0").rename(tmp_path / "aside")
    assert "cam00 lacks frame 0" in refusal(root)
    (root / "ims").rename(tmp_path / "aside2")
    assert "the pictures belong there" in refusal(root)
    for text in ("", "{", "[1]", '"x"', "\x00"):
        (root / "train_meta.json").write_text(text)
        assert "train_meta.json" in refusal(root)
    (root / "train_meta.json").unlink()
    assert "train_meta.json: is missing" in refusal(root)


Change = Callable[[dict[str, Any]], object]


def put(value: object, *path: object) -> Change:
    """Sets what stands in the tables at `path`; an Ellipsis in it stands for all frames."""

    def change(meta: dict[str, Any]) -> None:
        def into(table: Any, keys: tuple[object, ...]) -> None:
            for key in range(len(table)) if keys[0] is ... else keys[:1]:
                if len(keys) == 1:
                    table[key] = value
                else:
                    into(table[key], keys[1:])

        into(meta, path)

    return change


def drop_frame(meta: dict[str, Any]) -> None:
    for key in ("k", "w2c", "fn", "cam_id"):
        meta[key] = meta[key][:-1]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (put(9.0, "w2c", 2, 1, 0, 3), "cam02 moves at frame 2; only still cameras"),
        (put(99.0, "k", 1, 0, 0, 0), "cam00 changes its lens at frame 1"),
        (put(5.0, "k", ..., 0, 0, 1), "skewed pixels"),
        (put(1e-300, "k", ..., 0, 0, 0), "focal length"),
        (put(1e300, "k", ..., 0, 1, 1), "focal length"),
        (put(3.0, "w2c", ..., 0, 0, 0), "not a rotation"),
        (put("..\\secret.png", "fn", 1, 0), "not a path below ims/"),
        (put([2, 0, 3], "cam_id", 1), "cam_id of frame 1 differs"),
        (put([], "fn"), "fn is not a 3 x 3 table"),
        (drop_frame, "has 2 frames, test_meta.json 3"),
        (lambda m: m.pop("w2c"), "lacks w2c"),
        (lambda m: m.update(k=[[1, 2], [3]]), "k is not a table of 3x3"),
        (lambda m: m.update(w2c=[]), "w2c has shape (0,)"),
        (lambda m: m.update(w="wide"), "not whole numbers"),
        (lambda m: m.update(w=65), "is 64x36 px; train_meta.json declares 65x36 px"),
        (lambda m: m.update(cam_id=[[0, 1, 3]] * 3), "camera cam01 is listed twice"),
    ],
)
def test_bad_meta_is_refused(tmp_path: Path, change: Change, said: str) -> None:
    write_dynamic3dgs(tmp_path / "c")
    path = tmp_path / "c/train_meta.json"
    meta = json.loads(path.read_text())
    change(meta)
    path.write_text(json.dumps(meta))
    assert said in refusal(tmp_path / "c")


def test_picture_that_is_none_or_of_another_size(tmp_path: Path) -> None:
    write_dynamic3dgs(tmp_path / "c")
    (tmp_path / "c/ims/0/000001.png").write_bytes(b"not a picture")
    Image.fromarray(picture_of(0, 2)[:, :60]).save(tmp_path / "c/ims/0/000002.png")
    capture = open_capture(tmp_path / "c")
    source = capture.open_images(0)
    refused(InvalidError, "has 4 cameras", capture.open_images, 4)
    refused(InvalidError, "3 frames", source.read, 3)
    refused(CaptureError, r"000001\.png: not a picture", source.read, 1)
    refused(CaptureError, r"000002\.png: is 60x36 px", source.read, 2)
    (tmp_path / "c/ims/0/000000.png").write_bytes(b"")
    assert "not a picture" in refusal(tmp_path / "c")


def test_bad_points_are_refused(tmp_path: Path) -> None:
    write_dynamic3dgs(tmp_path / "c")
    one = np.ones((2, 3))
    bad: list[tuple[dict[str, np.ndarray], str]] = [
        ({"other": one}, "has neither"),
        ({"data": np.ones((3, 2))}, "(P, 6 or more)"),
        ({"xyz": one * np.nan, "rgb": one}, "not finite"),
        ({"xyz": one, "rgb": np.ones((3, 3))}, "rgb is"),
        ({"xyz": np.array([None, 1]), "rgb": one}, "init_pt_cld.npz"),
    ]
    for arrays, said in bad:
        np.savez(tmp_path / "c/init_pt_cld.npz", **arrays)  # type: ignore[arg-type]
        assert said in refusal(tmp_path / "c")
    (tmp_path / "c/init_pt_cld.npz").write_bytes(b"PK")
    assert "not an .npz file" in refusal(tmp_path / "c")
