"""Slices in the order of their Gaussians' contributions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from codec.errors import InvalidError
from codec.lattice.lattice import Lattice
from codec.slice import Slice, active_splats
from codec.splats import SH_C0, Splats
from codec.stream import StreamReader, StreamWriter
from codec.stream.layers import Rank
from player.render.cpu import render_splats
from tests.support.reference_render import scattered_splats, turned_camera
from tests.support.tiny_stream import tiny_manifest
from trainer.fit.config import FitConfig
from trainer.fit.trainer import Trainer
from trainer.pictures.shot import Shot
from trainer.run.rank import matured_by_contribution, slices_by_contribution
from trainer.seed.gaussians import initial_splats
from trainer.step.raster import View

NEAR_M = 0.2
WHITE = 0.5 / SH_C0
Doubles = npt.NDArray[np.float64]


def by_hand(splats: Splats) -> Doubles:
    """Contribution of each Gaussian: the picture with only this one white, all others black."""
    sums = np.zeros(len(splats))
    for i in range(len(splats)):
        sh = np.full_like(splats.sh, -WHITE)
        sh[i] = WHITE
        for camera in CAMERAS:
            picture = render_splats(replace(splats, sh=sh), camera, NEAR_M)
            sums[i] += float(picture[..., 1].sum(dtype=np.float64))
    return sums


def rows_of(part: Slice) -> list[bytes]:
    s = part.splats
    columns = (s.means, s.log_scales, s.quats, s.logit_opacities[:, None], s.sh[:, 0])
    table = np.concatenate([*columns, part.start_offsets[:, None]], axis=1)
    return [row.tobytes() for row in table.astype(np.float64)]


def assert_falls(values: Doubles) -> None:
    assert (np.diff(values) <= 1e-3).all(), values
    assert values[0] > values[-1] + 1


SWIN, FRAMES, SLICE_SIZE = 3, 4, 8
CAMERAS = [turned_camera(0.4, "a"), turned_camera(-0.3, "b")]


@pytest.fixture
def stream(tmp_path: Path) -> StreamReader:
    """A stream with exact floats; in every slice some Gaussians start late."""
    lattice = Lattice.suiting(scattered_splats(SLICE_SIZE, 50))
    manifest = replace(
        tiny_manifest(SWIN, segment_frames=2), slots=(SLICE_SIZE // 2,) * 2, near_m=NEAR_M,
        lattice=(lattice,) * 2, cameras=tuple(CAMERAS), default_camera="a",
    )  # fmt: skip
    with StreamWriter.create(tmp_path / "stream", manifest, exact=True) as writer:
        for birth in range(1 - SWIN, FRAMES):
            offsets = np.arange(SLICE_SIZE, dtype=np.uint8) % SWIN
            writer.append(Slice(birth, scattered_splats(SLICE_SIZE, birth + 50), offsets))
    return StreamReader(tmp_path / "stream")


def test_the_slices_of_a_stream_fall_by_what_they_show(
    stream: StreamReader, tmp_path: Path
) -> None:
    views = [View.prepare(cam, NEAR_M) for cam in CAMERAS]
    found = list(slices_by_contribution(stream, views))
    stored = list(stream.slices(1 - SWIN, 2))
    assert [part.birth for part in found] == [part.birth for part in stored]
    sums = {part.birth: np.zeros(SLICE_SIZE) for part in found}
    for frame in range(FRAMES):
        window = found[frame : frame + SWIN]
        added = by_hand(active_splats(window, frame, SWIN))
        for part in window:
            shown = part.active(frame, SWIN)
            sums[part.birth][shown] += added[: shown.sum()]
            added = added[shown.sum() :]
    for part, before in zip(found, stored, strict=True):
        assert sorted(rows_of(part)) == sorted(rows_of(before))
        assert_falls(sums[part.birth])
    assert [rows_of(part) for part in found] != [rows_of(part) for part in stored]
    # A stream written as given keeps the order in its layers.
    again = tmp_path / "again"
    with StreamWriter.create(again, stream.manifest, Rank.GIVEN, exact=True) as writer:
        for part in found:
            writer.append(part)
    reader = StreamReader(again)
    for part in found:
        assert rows_of(reader.slice(part.birth, 1)) == rows_of(part)[: SLICE_SIZE // 2]
        assert rows_of(reader.slice(part.birth, 2)) == rows_of(part)
    StreamWriter.create(tmp_path / "empty", stream.manifest).abort()
    with pytest.raises(InvalidError, match="no finished segment"):
        list(slices_by_contribution(StreamReader(tmp_path / "empty"), []))


class Grey:
    """Arbitrary pictures."""

    num_frames, cameras = FRAMES, CAMERAS

    def shot(self, camera: int, frame: int) -> Shot:
        return Shot(np.full((37, 45, 3), 60 + 30 * frame + 9 * camera, np.uint8))

    def mask(self, camera: int, frame: int) -> None:
        return None


@pytest.mark.parametrize("swin_size", [1, 2])
def test_a_trainers_slices_fall_by_what_they_show(swin_size: int) -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-0.7, 0.7, (24, 3)).astype(np.float32)
    initial = initial_splats(points, rng.integers(0, 255, (24, 3), dtype=np.uint8), 0)
    config = FitConfig(
        num_gs=24, swin_size=swin_size, genesis_iterations=40, settle_rounds=0, window_iterations=10
    )
    trainer = Trainer(config, Grey(), initial, NEAR_M)
    found: list[Slice] = []
    for window in trainer.windows():
        ordered = matured_by_contribution(trainer, window)
        for part, before in zip(ordered, window.slices, strict=True):
            assert part.birth == before.birth
            assert sorted(rows_of(part)) == sorted(rows_of(before))
        found += ordered
        if swin_size == 1:  # only the slice itself shows
            assert_falls(by_hand(ordered[0].splats))
    # The last slice shows only in the last frame, in which all shown Gaussians have matured.
    last = found[-swin_size:]
    shown = last[-1].active(FRAMES - 1, swin_size)
    assert shown.all()
    assert_falls(by_hand(active_splats(last, FRAMES - 1, swin_size))[-shown.sum() :])
