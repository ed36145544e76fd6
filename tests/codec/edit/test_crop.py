"""Cropped streams, and streams without floaters: the same Gaussians as cropped frames."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from codec.arrays import Doubles, Longs
from codec.camera import Camera, look_at
from codec.edit.filters import CropOptions, FloaterOptions
from codec.edit.rewrite import edit_stream
from codec.errors import InvalidError
from codec.lattice.lattice import Lattice, quantise
from codec.slots.slotlayout import KEPT, NEW, PREDICTED, SlotLayout, Update
from codec.splats import Splats
from codec.stream import StreamReader, StreamWriter
from codec.tools.audit import verify_stream
from codec.tools.croppreview import draw_crop
from tests.support.hostile import refused
from tests.support.slots.edited import (
    NUM_FRAMES,
    edited_frames,
    frames_of,
    objects_bytes,
    segment_files,
    write_trained_like,
)
from tests.support.slots.slot_streams import gaussians, slot_manifest, write_slot_stream
from tests.support.slots.updates import small_layout
from tests.support.trained_like import trained_like_splats

BOX = (-0.5, 0.2, -0.5, 0.6, 1.3, 0.5)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_trained_like(tmp_path_factory.mktemp("crop") / "s", 1)


def in_box(means: Doubles, box: tuple[float, ...] = BOX) -> Longs:
    inside: Longs = np.flatnonzero(((means >= box[:3]) & (means <= box[3:])).all(axis=1))
    return inside


@pytest.mark.parametrize("swin_size", [1, 5])
def test_a_box_and_its_complement_share_the_gaussians(swin_size: int, tmp_path: Path) -> None:
    source = write_trained_like(tmp_path / "s", swin_size)
    edit_stream(source, tmp_path / "in", CropOptions(box=BOX))
    edit_stream(source, tmp_path / "out", CropOptions(box=BOX, outside=True))
    for name in ("in", "out"):
        verify_stream(tmp_path / name)
        assert objects_bytes(tmp_path / name) < objects_bytes(source)
    frames = [frames_of(path) for path in (source, tmp_path / "in", tmp_path / "out")]
    for whole, inside, outside in zip(*frames, strict=True):
        wanted = whole.take(in_box(whole.means.astype(np.float64)))
        assert len(wanted)
        assert gaussians(inside) == gaussians(wanted)
        assert gaussians(inside) + gaussians(outside) == gaussians(whole)


@pytest.mark.parametrize("swin_size", [1, 2, 3])
def test_patternless_streams_cropped(swin_size: int, tmp_path: Path) -> None:
    layout = small_layout(swin_size, (20, 10), 1, 4)
    source = write_slot_stream(tmp_path / "s", 14, layout, 1)
    box = (-2.0, -2.0, -50.0, 1.5, 2.0, 3.0)
    for whole, found in edited_frames(source, tmp_path / "t", CropOptions(box=box)):
        wanted = whole.take(in_box(whole.means.astype(np.float64), box))
        assert gaussians(found) == gaussians(wanted)


def test_what_is_untouched_keeps_its_bytes_and_its_psnr(tmp_path: Path) -> None:
    score = [20.0, 21, 22, 23]
    source = write_trained_like(tmp_path / "s", 1, quality=lambda frame, slices: score)
    everything = CropOptions(sphere=(0, 0, 0, 1e4))
    made = edit_stream(source, tmp_path / "t", everything)
    assert segment_files(tmp_path / "t") == segment_files(source)
    assert (made.num_copied, made.num_segments) == (3, 3)
    before, after = StreamReader(source), StreamReader(tmp_path / "t")
    assert after.records == before.records
    assert after.manifest.bounds == before.manifest.bounds
    # A removed Gaussian changes every segment, so that no PSNR is known.
    edit_stream(source, tmp_path / "u", CropOptions(box=BOX))
    assert all(math.isnan(record.psnr_db[0]) for record in StreamReader(tmp_path / "u").records)


def test_a_crop_says_how_much_stays_and_an_empty_one_is_refused(
    source: Path, tmp_path: Path
) -> None:
    whole = next(iter(frames_of(source))).means.astype(np.float64)
    counts = len(in_box(whole)), len(whole)
    made = edit_stream(source, tmp_path / "t", CropOptions(box=BOX))
    assert made.notes == ("kept         {} of {} Gaussians in frame 0".format(*counts),)
    assert draw_crop(source, CropOptions(box=BOX), tmp_path / "crop.png", None) == counts
    pixels = np.asarray(Image.open(tmp_path / "crop.png").convert("RGB")).astype(int)
    assert (pixels[..., 0] - pixels[..., 2] > 60).mean() > 0.001  # what goes is red
    far = CropOptions(sphere=(99, 0, 0, 1))
    says = f"no Gaussian is in that region in any frame, of {counts[1]} in frame 0; .*--preview"
    refused(InvalidError, says, edit_stream, source, tmp_path / "u", far)
    assert draw_crop(source, far, tmp_path / "far.png", None) == (0, counts[1])
    assert not (tmp_path / "u").exists()


def test_an_edit_that_is_interrupted_leaves_nothing(source: Path, tmp_path: Path) -> None:
    def interrupt(done: int, total: int) -> None:
        assert total == NUM_FRAMES
        if done == 10:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        edit_stream(source, tmp_path / "t", CropOptions(box=BOX), progress=interrupt)
    assert not list(tmp_path.iterdir())


LATTICE = Lattice(0.01, 0.125, 1 / 60, 0.056, 41)


def camera(name: str, x: float) -> Camera:
    """A camera at (x, 0, -4) that looks at the origin, with a field of view of 90 degrees."""
    pose = look_at(np.array([x, 0.0, -4.0]), np.zeros(3), np.array([0.0, -1.0, 0.0]))
    return Camera(name, 100, 100, 50.0, 50.0, 50.0, 50.0, pose)


PLACES = ((0.0, 0.0, 0.0), (0.0, 0.0, -9.0), (-1.2, 0.0, -3.2), (0.0, 30.0, 0.0))
"""Seen by both cameras; behind both; seen by the left one only; outside both pictures."""


def write(path: Path) -> Path:
    """Writes six frames of four Gaussians at PLACES. In frame 4 the last one moves between the
    cameras, and the first one is replaced by one that no camera sees."""
    layout = SlotLayout(1, (4,), 0, (LATTICE,), 3)
    cameras = camera("a", -1.0), camera("b", 1.0)
    manifest = slot_manifest(layout, cameras=cameras, default_camera="a", near_m=0.1)
    arrays = trained_like_splats(4).arrays
    with StreamWriter.create(path, manifest) as writer:
        for birth in range(6):
            places = np.array(PLACES, np.float32)
            statuses = np.full(4, NEW if birth == 0 else KEPT, np.uint8)
            if birth == 4:
                statuses[:] = NEW, KEPT, KEPT, PREDICTED
                places[0], places[3] = (0, 0, -20), (0, 0, 1)
            states, _ = quantise(Splats(places, *arrays[1:]), LATTICE)
            coded = np.flatnonzero(statuses >= PREDICTED)
            none = np.zeros(len(coded), np.uint8)
            writer.append(
                Update(birth, statuses, states.take(coded), none, none.astype(bool), Splats.empty())
            )
    return path


def depths(stream: Path) -> list[list[float]]:
    """The sum of z and y of each Gaussian, frame after frame."""
    return [
        [round(float(z), 1) for z in np.sort(s.means[:, 1] + s.means[:, 2])]
        for s in frames_of(stream)
    ]


def test_a_gaussian_stays_if_enough_cameras_see_it_at_any_time(tmp_path: Path) -> None:
    source = write(tmp_path / "s")
    made = edit_stream(source, tmp_path / "two", FloaterOptions(cameras=2))
    verify_stream(tmp_path / "two")
    # The fourth one moves into view later, so that it stays from its first frame on.
    assert depths(tmp_path / "two") == [[0.0, 30.0]] * 4 + [[1.0]] * 2
    assert made.notes == ("floaters     3 of 5 Gaussians",)
    assert objects_bytes(tmp_path / "two") < objects_bytes(source)
    edit_stream(source, tmp_path / "one", FloaterOptions(cameras=1))
    assert depths(tmp_path / "one") == [[-3.2, 0.0, 30.0]] * 4 + [[-3.2, 1.0]] * 2
    # A wide margin keeps what lies beside the pictures.
    edit_stream(source, tmp_path / "wide", FloaterOptions(cameras=2, margin=10))
    assert all(-9.0 not in found for found in depths(tmp_path / "wide"))
    assert all(30.0 in found for found in depths(tmp_path / "wide")[:4])
    # Where all are seen nothing changes.
    made = edit_stream(tmp_path / "two", tmp_path / "again", FloaterOptions(cameras=2))
    assert segment_files(tmp_path / "again") == segment_files(tmp_path / "two")
    assert made.num_copied == made.num_segments == 2
    assert len(StreamReader(source).manifest.cameras) == 2
    with pytest.raises(InvalidError, match="has only 2"):
        edit_stream(source, tmp_path / "t", FloaterOptions(cameras=3))
    for wrong in ({"cameras": 0}, {"margin": -1}):
        refused(InvalidError, r"at least 1|margin", FloaterOptions, **wrong)
