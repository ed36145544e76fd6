"""Gaussians that too few cameras see at every time of their life go; the rest stays unchanged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from codec.camera import Camera
from codec.edit.editing import edit_stream
from codec.edit.floaters import FloaterOptions
from codec.errors import InvalidError
from codec.lattice.lattice import Lattice, quantise
from codec.pose import look_at
from codec.slots.slotlayout import SlotLayout
from codec.slots.update import KEPT, NEW, PREDICTED, Update
from codec.splats import Splats
from codec.stream import StreamReader, StreamWriter
from codec.tools.audit import verify_stream
from tests.support.slots.edited import frames_of, objects_bytes, segment_files
from tests.support.slots.slot_streams import slot_manifest
from tests.support.trained_like import trained_like_splats

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
        with pytest.raises(InvalidError, match=r"at least 1|margin"):
            FloaterOptions(**wrong)
