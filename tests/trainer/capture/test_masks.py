"""Masks of a capture: their places in the layouts, their meaning, and refusals."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from codec.arrays import Bytes
from codec.camera import Camera
from tests.support import tiny_models
from tests.support.footage.checking import checked
from tests.support.hostile import refused
from tests.support.tiny_capture import (
    HEIGHT_PX,
    WIDTH_PX,
    refusal,
    tiny_rig,
    write_dynamic3dgs,
    write_dynerf,
)
from tests.support.tiny_models import transforms_of, write_pictures, write_transforms
from tests.trainer.capture.test_colmap import write_colmap
from trainer.capture.capture import Capture
from trainer.capture.layout import open_capture
from trainer.errors import CaptureError
from trainer.run.check import describe_capture

NUM_FRAMES = 3


def grey_of(camera_index: int, frame: int) -> Bytes:
    """(36, 64) white rectangle that encodes camera and frame, on a grey that is just too dark."""
    grey = np.full((HEIGHT_PX, WIDTH_PX), 127, np.uint8)
    grey[3 + frame : 30, 5 + camera_index : 50] = 128
    return grey


def save_mask(path: Path, camera_index: int, frame: int, columns: slice = slice(None)) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(grey_of(camera_index, frame)[:, columns]).save(path)


def mask(capture: Capture, camera_index: int, frame: int) -> Bytes:
    masks = capture.cameras[camera_index].masks
    assert masks is not None
    return masks.read(frame)


def masked_cameras(root: Path) -> list[str]:
    return [c.camera.name for c in open_capture(root).cameras if c.masks is not None]


def expect(root: Path, camera_index: int, drawn_frames: Sequence[int] = range(NUM_FRAMES)) -> None:
    """Asserts that a camera's masks, by frame, are those drawn for these frames."""
    capture = open_capture(root)
    for frame, drawn in enumerate(drawn_frames):
        got = mask(capture, camera_index, frame)
        assert got.dtype == np.uint8
        assert np.array_equal(got, grey_of(camera_index, drawn) >= 128)


def mirrored(root: Path, picture: str, name_of: Callable[[Path], str]) -> Path:
    below = Path(picture).relative_to(Path(picture).parts[0])
    return root / "masks" / below.parent / name_of(below)


@pytest.mark.parametrize("by_frame", [True, False])
@pytest.mark.parametrize("whole_name", [True, False])
def test_colmap_masks_mirror_the_pictures(tmp_path: Path, by_frame: bool, whole_name: bool) -> None:
    paths = write_colmap(tmp_path, by_frame=by_frame)
    for frame, path in enumerate(paths[1]):
        name = mirrored(tmp_path, path, lambda p: p.name + ".png" if whole_name else p.name)
        save_mask(name, 1, frame)
    assert masked_cameras(tmp_path) == ["cam01"]
    expect(tmp_path, 1)


def test_colmap_masks_that_cannot_be_used(tmp_path: Path) -> None:
    paths = write_colmap(tmp_path)
    assert not masked_cameras(tmp_path)
    (tmp_path / "masks").mkdir()
    assert "masks: has no mask of a picture in frames/" in refusal(tmp_path)
    files = [mirrored(tmp_path, path, lambda p: p.name + ".png") for path in paths[2]]
    for frame, file in enumerate(files):
        save_mask(file, 2, frame)
    files[2].write_bytes(b"none")
    capture = open_capture(tmp_path)
    refused(CaptureError, "frame_09/cam02.png.png: not a mask", mask, capture, 2, 2)
    refused(CaptureError, "frame_09/cam02.png.png: not a mask", checked, tmp_path)
    Image.fromarray(np.minimum(grey_of(2, 1), 1)).save(files[1])
    refused(CaptureError, "its brightest pixel is 1 of 255", mask, capture, 2, 1)
    Image.fromarray(np.zeros((HEIGHT_PX, WIDTH_PX), np.uint8)).save(files[1])
    assert not mask(capture, 2, 1).any()
    files[1].unlink()
    said = refusal(tmp_path)
    assert "frame_08/cam02.png.png: is missing; a camera with masks needs one for every" in said


def write_nerfstudio(root: Path, listed: bool) -> tuple[list[Camera], dict[str, Any]]:
    cameras = tiny_rig(3)
    paths = write_pictures(root, cameras, NUM_FRAMES, False)
    return cameras, transforms_of(cameras, paths if listed else [p[:1] for p in paths])


def test_nerfstudio_has_a_mask_for_each_entry(tmp_path: Path) -> None:
    _, value = write_nerfstudio(tmp_path, listed=True)
    for frame in range(NUM_FRAMES):
        value["frames"][NUM_FRAMES + frame]["mask_path"] = f"./m/{frame}.png"
        save_mask(tmp_path / f"m/{frame}.png", 1, frame)
    write_transforms(tmp_path, value)
    assert masked_cameras(tmp_path) == ["cam01"]
    expect(tmp_path, 1)
    (tmp_path / "m/2.png").unlink()
    assert "m/2.png: is missing; a mask_path" in refusal(tmp_path)
    del value["frames"][NUM_FRAMES + 1]["mask_path"]
    write_transforms(tmp_path, value)
    said = refusal(tmp_path)
    assert "images/cam01/0008.png has no mask_path" in said
    for bad, why in ((7, "mask_path is '7', not a path"), ("../x.png", "not a path inside")):
        value["frames"][NUM_FRAMES + 1]["mask_path"] = bad
        write_transforms(tmp_path, value)
        assert why in refusal(tmp_path)


@pytest.mark.parametrize("form", ["pictures", "listed", "videos"])
def test_nerfstudio_masks_of_a_whole_camera(form: str, tmp_path: Path) -> None:
    """One entry for all frames, and entries that all name one file."""
    cameras, value = write_nerfstudio(tmp_path, listed=form == "listed")
    if form == "videos":
        value = transforms_of(cameras, tiny_models.write_videos(tmp_path, cameras, NUM_FRAMES))
    for entry in value["frames"][2 * len(value["frames"]) // 3 :]:
        entry["mask_path"] = "still.png"
    save_mask(tmp_path / "still.png", 2, 1)
    write_transforms(tmp_path, value)
    masks = open_capture(tmp_path).cameras[2].masks
    assert masks is not None
    assert masks.is_still
    expect(tmp_path, 2, [1] * NUM_FRAMES)


def test_masks_are_straightened_with_their_pictures(tmp_path: Path) -> None:
    """The picture is the mask in grey: the mask is set where the undistorted picture is white."""
    cameras = tiny_rig(3)

    def as_picture(index: int, frame: int) -> Bytes:
        white = np.where(grey_of(index, frame) >= 128, 255, 0).astype(np.uint8)
        return np.ascontiguousarray(np.stack([white] * 3, axis=2))

    paths = write_pictures(tmp_path, cameras, NUM_FRAMES, False, as_picture)
    value = transforms_of(cameras, [p[:1] for p in paths]) | {"k1": -0.15, "k2": 0.02, "p1": 0.003}
    value["frames"][1]["mask_path"] = "m.png"
    save_mask(tmp_path / "m.png", 1, 2)
    write_transforms(tmp_path, value)
    capture = open_capture(tmp_path)
    straight = mask(capture, 1, 2)
    picture = capture.open_images(1).read(2)[..., 0]
    assert np.array_equal(straight, picture == 255)
    assert not np.array_equal(straight, grey_of(1, 2) >= 128)
    assert ((picture > 0) & (picture < 255) & (straight == 0)).any()


def write_layout(root: Path, layout: str) -> None:
    """Pictures or videos of at least three cameras, cam00 and so on, without masks."""
    match layout:
        case "dynamic3dgs":
            write_dynamic3dgs(root, num_frames=NUM_FRAMES)
        case "dynerf":
            write_dynerf(root, num_frames=NUM_FRAMES)
        case "colmap" | "colmap by camera":
            write_colmap(root, by_frame=layout == "colmap")
        case "easymocap":
            tiny_models.write_easymocap(root, 3, NUM_FRAMES)
        case "nerfstudio":
            write_transforms(root, write_nerfstudio(root, listed=True)[1])
        case _:
            cameras = tiny_rig(3)
            write_transforms(
                root, transforms_of(cameras, tiny_models.write_videos(root, cameras, NUM_FRAMES))
            )


LAYOUTS = (
    "dynamic3dgs", "dynerf", "colmap", "colmap by camera", "nerfstudio", "nerfstudio videos",
    "easymocap",
)  # fmt: skip


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_takes_a_folder_of_masks_for_a_camera(tmp_path: Path, layout: str) -> None:
    root = tmp_path / "c"
    write_layout(root, layout)
    for frame in range(NUM_FRAMES):
        save_mask(root / f"masks/cam01/mask_{frame + 7:04d}.png", 1, frame)
    save_mask(root / "masks/cam02/0.png", 2, 1)  # for all frames
    (root / "masks/.DS_Store").touch()
    assert masked_cameras(root) == ["cam01", "cam02"]
    expect(root, 1)
    expect(root, 2, [1] * NUM_FRAMES)
    capture = open_capture(root)
    (line,) = (line for line in describe_capture(capture) if line.startswith("masks"))
    assert f"2 of {len(capture.cameras)} cameras have them, 1 one for all frames" in line


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_folder_of_masks_that_cannot_be_used(tmp_path: Path, layout: str) -> None:
    root, is_colmap = tmp_path / "c", layout.startswith("colmap")
    write_layout(root, layout)
    folder = root / "masks/cam01"

    folder.mkdir(parents=True)
    says = "masks: has no mask" if is_colmap else "masks/cam01: holds no numbered"
    assert says in refusal(root)
    save_mask(folder / "0.png", 1, 0)
    save_mask(folder / "2.png", 1, 2, slice(1, None))
    assert "masks/cam01: frame 1 is missing before frame 2" in refusal(root)
    save_mask(folder / "1.png", 1, 1)
    capture = open_capture(root)
    refused(CaptureError, "masks/cam01/2.png: is 63x36 px", mask, capture, 1, 2)
    (folder / "2.png").unlink()
    assert "masks/cam01: has 2 masks, 0.png to 1.png, for 3 frames; give one" in refusal(root)
    save_mask(folder / "2.png", 1, 2)
    save_mask(folder / "0.png", 1, 0, slice(1, None))
    assert "masks/cam01/0.png: is 63x36 px; its picture has 64x36 px" in refusal(root)
    shutil.rmtree(folder)
    (root / "masks/README.txt").write_text("By hand.")  # a plain file beside masks is none
    assert is_colmap or not masked_cameras(root)  # colmap refuses a masks folder without masks
    save_mask(root / "masks/cam02/0.png", 2, 1)
    (root / "masks/kamera").mkdir()
    assert masked_cameras(root) == ["cam02"]
    save_mask(root / "masks/kamera/0.png", 1, 0)
    assert "masks/kamera: is not the name of a camera (cam00, cam01, cam02" in refusal(root)


@pytest.mark.parametrize("layout", ["colmap", "colmap by camera", "nerfstudio"])
def test_masks_of_a_camera_without_a_pose_are_left_out(tmp_path: Path, layout: str) -> None:
    if layout == "nerfstudio":
        _, value = write_nerfstudio(tmp_path, listed=True)
        del value["frames"][2 * NUM_FRAMES :]
        write_transforms(tmp_path, value)
    else:
        cameras = tiny_rig(3)
        tiny_models.write_model(tmp_path / "sparse", cameras[:2], ["cam00.png", "cam01.png"], True)
        write_pictures(tmp_path, cameras, NUM_FRAMES, by_frame=layout == "colmap")
    for index in range(3):
        for frame in range(NUM_FRAMES):
            save_mask(tmp_path / f"masks/cam0{index}/{frame + 7:04d}.png", index, frame)
    assert masked_cameras(tmp_path) == ["cam00", "cam01"]
    expect(tmp_path, 1)
    save_mask(tmp_path / "masks/cam09/0007.png", 1, 0)  # a camera without pictures
    assert "masks/cam09: is not the name" in refusal(tmp_path)
