"""swings-eval --compare: the captured picture, the stream's picture, and the error."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from codec.arrays import Floats
from codec.errors import InvalidError
from codec.stream import StreamReader
from tests.support.commands import run_ok
from tests.support.tiny_capture import HEIGHT_PX, WIDTH_PX, picture_of, seen_by, write_dynamic3dgs
from tests.support.tiny_stream import tiny_manifest, write_tiny
from trainer.score.evaluate import EvaluateConfig
from trainer.score.sidebyside import MOST_ERROR, error_colours, side_by_side, write_side_by_side
from trainer.score.truth import captured, displayed
from trainer.step.loss import psnr_db

FRAMES = 6


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a capture, and a stream with its cameras."""
    root = tmp_path_factory.mktemp("compared")
    write_dynamic3dgs(root / "capture", num_cameras=3, num_frames=FRAMES)
    write_tiny(root / "stream", FRAMES, seen_by(tiny_manifest(), root / "capture"))
    return root


@pytest.mark.parametrize("index", [0, 2])
def test_pictures_have_truth_rendered_and_error(folder: Path, tmp_path: Path, index: int) -> None:
    """This holds for any camera, held out or not."""
    reader = StreamReader(folder / "stream")
    camera = reader.manifest.cameras[index]
    config = EvaluateConfig(folder / "stream", folder / "capture")
    found = write_side_by_side(config, camera.name, tmp_path / "out")
    scores_db = []
    for frame in range(FRAMES):
        picture = np.asarray(Image.open(tmp_path / "out" / f"frame_{frame:05d}.png"))
        header_px = picture.shape[0] - HEIGHT_PX
        assert picture.shape == (HEIGHT_PX + header_px, 3 * WIDTH_PX, 3)
        assert picture[:header_px].max() > 200
        truth, shown, error = np.split(picture[header_px:], 3, axis=1)
        assert np.abs(truth.astype(int) - picture_of(index, frame)).mean() < 3  # stored as a JPEG
        splats = reader.active_splats(frame, 2)
        expected = displayed(splats, camera, reader.manifest.near_m)
        np.testing.assert_array_equal(shown, np.rint(expected * 255).astype(np.uint8))
        wrong = np.abs(expected - captured(truth)).mean(axis=2)
        np.testing.assert_array_equal(error, error_colours(wrong))
        scores_db.append(psnr_db(expected, captured(truth), None))
    assert (found.camera, found.frames) == (camera.name, FRAMES)
    assert found.psnr_db == pytest.approx(np.mean(scores_db), abs=1e-4)


def test_colours_of_errors_grow_brighter_to_the_end_of_the_bar() -> None:
    errors = np.linspace(0, MOST_ERROR, 256, dtype=np.float32)
    light = error_colours(errors).astype(int).sum(axis=1)
    assert light[0] < 10
    assert light[-1] > 600
    assert (np.diff(light) >= -1).all()
    beyond = error_colours(np.array([MOST_ERROR, 0.9], np.float32))
    np.testing.assert_array_equal(beyond[0], beyond[1])


@pytest.mark.parametrize(("height_px", "width_px"), [(1, 1), (36, 64), (7, 300), (360, 640)])
def test_any_size_of_picture_gets_its_labels(height_px: int, width_px: int) -> None:
    truth: Floats = np.full((height_px, width_px, 3), 0.5, np.float32)
    mask = np.zeros((height_px, width_px), np.uint8)
    shown = truth + np.float32(0.2)
    for counting in (None, mask):
        picture = side_by_side(truth, shown, counting, ("camera " * 50, "x"))
        header_px = len(picture) - height_px
        error = picture[header_px:, 2 * width_px :]
        wrong = 0 if counting is not None else np.float32(0.2)
        expected = error_colours(np.full((height_px, width_px), wrong, np.float32))
        np.testing.assert_array_equal(error, expected)


def test_the_command_writes_a_video_and_one_line(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.mp4"
    name = StreamReader(folder / "stream").manifest.cameras[1].name
    arguments = (folder / "stream", folder / "capture")
    told = run_ok("swings-eval", *arguments, "--compare", name, out, "--every", 2)
    assert told.startswith(f"3 frames from {name}, ")
    assert told.endswith(f" dB: {out}\n")
    with av.open(str(out)) as container:
        assert container.streams.video[0].average_rate == 12.5
        assert len(list(container.decode(video=0))) == 3
    assert [path.name for path in tmp_path.iterdir()] == ["out.mp4"]


def test_a_camera_that_is_not_there_is_named_and_nothing_left(folder: Path, tmp_path: Path) -> None:
    config = EvaluateConfig(folder / "stream", folder / "capture")
    with pytest.raises(InvalidError, match="has no camera 'nobody'; it has "):
        write_side_by_side(config, "nobody", tmp_path / "out")
    assert list(tmp_path.iterdir()) == []
