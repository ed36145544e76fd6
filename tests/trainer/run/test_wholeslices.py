"""Slices sent whole: lattices, the effect of quantisation, and the order by contribution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from codec.arrays import Doubles
from codec.camera import Camera
from codec.errors import InvalidError
from codec.lattice.lattice import SCALES, TURNS, Lattice, lattice_values
from codec.slice import Slice, active_splats
from codec.slots.slotlayout import NEW
from codec.slots.state import ESCAPED, ON_LATTICE
from codec.splats import SH_C0, Splats
from codec.stream import StreamReader, StreamWriter
from codec.stream.manifest import Manifest
from codec.stream.wholeslice import Rank
from codec.tools.audit import count_slots
from player.render.cpu import render_splats
from tests.support.reference_render import scattered_splats, turned_camera
from tests.support.tiny_stream import tiny_manifest
from tests.trainer.fit.test_trainer import NEAR_M, QUICK, Rendered, start
from trainer.fit.config import FitConfig
from trainer.fit.mcmc import McmcConfig
from trainer.fit.observer import Observer
from trainer.fit.trainer import Trainer
from trainer.pictures.framecache import CapturePictures, FrameCache
from trainer.run.config import TrainConfig
from trainer.run.job import train_stream
from trainer.run.outputs import matured_by_contribution, run_targets, slices_by_contribution
from trainer.run.prepare import first_gaussians, layer_slots, make_manifest, prepare
from trainer.step.raster import View

NUM_FRAMES, WINDOW = 5, 2


def manifest_of(capture: Path, whole_slices: bool) -> Manifest:
    fit, none = FitConfig(num_gs=400), capture.parent / "none"
    config = TrainConfig(capture, none, rank="coverage", whole_slices=whole_slices, fit=fit)
    prepared = prepare(config)
    with FrameCache(prepared.capture, prepared.frames) as cache:
        pictures = CapturePictures(cache, prepared.capture.training)
        initial = first_gaussians(config, prepared, pictures)
        return make_manifest(config, prepared, cache, initial)


def test_lattices_of_whole_slices_are_coarser_from_layer_to_layer(capture: Path) -> None:
    whole, lasting = (manifest_of(capture, whole_slices) for whole_slices in (True, False))
    assert whole.slots == lasting.slots == (140, 60, 80, 120)
    # A slot may change its rank, so its lattice must not depend on it.
    (shared,) = set(lasting.lattice)
    for name in ("position_m", "log_scale", "rotation", "colour"):
        steps = [getattr(lattice, name) for lattice in whole.lattice]
        assert steps == sorted(set(steps))
        assert steps[0] < getattr(shared, name) < steps[-1]
    assert {lattice.opacity_levels for lattice in whole.lattice} == {shared.opacity_levels}


def trained(config: TrainConfig, observers: Sequence[Observer] = ()) -> list[StreamReader]:
    """The streams that a run has written."""
    train_stream(config, Console(quiet=True), observers=observers)
    return [StreamReader(path) for path in run_targets(config)]


def config_of(capture: Path, folder: Path) -> TrainConfig:
    """A run that writes a stream and a raw stream to `folder`."""
    fit = FitConfig(
        num_gs=120, swin_size=WINDOW, genesis_iterations=40, settle_rounds=0, window_iterations=20,
        mcmc=McmcConfig(relocate_period=10),
    )  # fmt: skip
    return TrainConfig(
        capture, folder / "stream", raw_stream=folder / "raw", whole_slices=True, segment_frames=2,
        snapshot_every=0, frames=f"0:{NUM_FRAMES}", fit=fit,
    )  # fmt: skip


@pytest.fixture(scope="module")
def streams(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> list[StreamReader]:
    return trained(config_of(capture, tmp_path_factory.mktemp("whole")))


def test_raw_streams_hold_what_the_other_rounds_to_lattices(streams: list[StreamReader]) -> None:
    coded, exact = streams
    manifest = coded.manifest
    assert exact.manifest_json == coded.manifest_json
    assert exact.num_frames == coded.num_frames == NUM_FRAMES
    for reader in streams:  # nothing is leased: in every slice each slot is new
        census = count_slots(reader)
        assert (census.statuses[1:, :, NEW] == manifest.slots).all()
        assert np.array_equal(census.first, WINDOW * np.array(manifest.slots))
    for birth in range(NUM_FRAMES):
        lanes = (
            reader.decoder_at(birth, manifest.num_layers).lanes[birth % WINDOW]
            for reader in streams
        )
        for lattice, mine, theirs in zip(manifest.lattice, *lanes, strict=True):
            assert (mine.conditions == ON_LATTICE).all()
            assert (theirs.conditions == ESCAPED).all()
            values = lattice_values(theirs.escapes, lattice)
            # An axis thinner than the lattice's minimum has that minimum.
            sizes = values[:, 3 + SCALES : 3 + TURNS]
            np.maximum(sizes, -128, out=sizes)
            # Each stream has its own order within a layer.
            apart = np.abs(mine.states.numbers()[:, None] - values).max(axis=2)
            nearest = apart.argmin(axis=1)
            assert sorted(nearest) == list(range(len(values)))
            assert apart.min(axis=1).max() <= 0.5
            assert apart.max(axis=1).min() > 1  # others are further away
            starts = theirs.starts[theirs.escape_rows]
            assert np.array_equal(mine.starts, starts[nearest])


class Stopper(Observer):
    """Ends a run between two segments."""

    def window_ended(self, first_frame: int) -> None:
        if first_frame == 2:
            raise InterruptedError


def test_resume_keeps_floats(streams: list[StreamReader], capture: Path, tmp_path: Path) -> None:
    config = config_of(capture, tmp_path)
    with pytest.raises(InterruptedError):
        trained(config, [Stopper()])
    before = [StreamReader(path) for path in run_targets(config)]
    assert [(reader.num_frames, reader.manifest.live) for reader in before] == [(2, True)] * 2
    after = trained(replace(config, resume=True))
    assert [reader.records for reader in after] == [reader.records for reader in streams]


def test_a_layer_without_a_gaussian_is_refused() -> None:
    assert layer_slots((0.35, 0.15, 0.2, 0.3), 4) == (1, 1, 1, 1)
    with pytest.raises(InvalidError, match="2 Gaussians in a slice leave a layer without any"):
        layer_slots((0.35, 0.15, 0.2, 0.3), 2)


WHITE = 0.5 / SH_C0


def by_hand(splats: Splats, cameras: Sequence[Camera]) -> Doubles:
    """Contribution of each Gaussian: the picture with only this one white, all others black."""
    sums = np.zeros(len(splats))
    for i in range(len(splats)):
        sh = np.full_like(splats.sh, -WHITE)
        sh[i] = WHITE
        for camera in cameras:
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


def test_slices_of_a_stream_fall_by_what_they_show(stream: StreamReader, tmp_path: Path) -> None:
    views = [View.prepare(cam, NEAR_M) for cam in CAMERAS]
    found = list(slices_by_contribution(stream, views))
    stored = list(stream.slices(1 - SWIN, 2))
    assert [part.birth for part in found] == [part.birth for part in stored]
    sums = {part.birth: np.zeros(SLICE_SIZE) for part in found}
    for frame in range(FRAMES):
        window = found[frame : frame + SWIN]
        added = by_hand(active_splats(window, frame, SWIN), CAMERAS)
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


@pytest.mark.parametrize("swin_size", [1, 3])
def test_a_trainers_slices_fall_by_what_they_show(swin_size: int) -> None:
    config, pictures = replace(QUICK, swin_size=swin_size, window_iterations=10), Rendered()
    trainer, found = Trainer(config, pictures, start(), NEAR_M), list[Slice]()
    for window in trainer.windows():
        ordered = matured_by_contribution(trainer, window)
        for part, before in zip(ordered, window.slices, strict=True):
            assert part.birth == before.birth
            assert sorted(rows_of(part)) == sorted(rows_of(before))
        found += ordered
    # The last slice shows only in the last frame, in which all shown Gaussians have matured.
    last, frame = found[-swin_size:], pictures.num_frames - 1
    shown = last[-1].active(frame, swin_size)
    assert shown.all()
    added = by_hand(active_splats(last, frame, swin_size), pictures.cameras)
    assert_falls(added[-shown.sum() :])
