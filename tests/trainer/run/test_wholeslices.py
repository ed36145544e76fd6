"""Slices sent whole: their lattices, and the effect of quantisation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from codec.errors import InvalidError
from codec.lattice.lattice import SCALES, TURNS, lattice_values
from codec.slots.slotstate import ESCAPED, ON_LATTICE
from codec.slots.update import NEW
from codec.stream import StreamReader
from codec.stream.manifest import Manifest
from codec.tools.slotcensus import count_slots
from trainer.fit.config import FitConfig
from trainer.fit.mcmc import McmcConfig
from trainer.fit.observer import Observer
from trainer.pictures.feed import CapturePictures
from trainer.pictures.framecache import FrameCache
from trainer.run.config import TrainConfig
from trainer.run.job import train_stream
from trainer.run.outputs import run_targets
from trainer.run.prepare import first_gaussians, layer_slots, make_manifest, prepare

FRAMES, SWIN = 5, 2


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


def trained(config: TrainConfig, observers: Sequence[Observer] = ()) -> TrainConfig:
    train_stream(config, Console(quiet=True), observers=observers)
    return config


def config_of(capture: Path, folder: Path) -> TrainConfig:
    """A run that writes a stream and a raw stream to `folder`."""
    fit = FitConfig(
        num_gs=120, swin_size=SWIN, genesis_iterations=40, settle_rounds=0, window_iterations=20,
        mcmc=McmcConfig(relocate_period=10),
    )  # fmt: skip
    return TrainConfig(
        capture, folder / "stream", raw_stream=folder / "raw", whole_slices=True, segment_frames=2,
        snapshot_every=0, frames=f"0:{FRAMES}", fit=fit,
    )  # fmt: skip


@pytest.fixture(scope="module")
def streams(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> list[StreamReader]:
    """The streams that a run has written."""
    config = trained(config_of(capture, tmp_path_factory.mktemp("whole")))
    return [StreamReader(path) for path in run_targets(config)]


def test_the_raw_stream_holds_what_the_other_rounds_to_the_lattice(
    streams: list[StreamReader],
) -> None:
    coded, exact = streams
    manifest = coded.manifest
    assert exact.manifest_json == coded.manifest_json
    assert exact.num_frames == coded.num_frames == FRAMES
    for reader in streams:
        assert (count_slots(reader).statuses[1:, :, NEW] == manifest.slots).all()
    for birth in range(FRAMES):
        lanes = (
            reader.decoder_at(birth, manifest.num_layers).lanes[birth % SWIN] for reader in streams
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


class StoppedError(Exception):
    """Stands for any cause that ends a run."""


class Stopper(Observer):
    """Ends a run between two segments."""

    def window_ended(self, first_frame: int) -> None:
        if first_frame == 2:
            raise StoppedError


def test_a_resumed_run_goes_on_with_every_float(
    streams: list[StreamReader], capture: Path, tmp_path: Path
) -> None:
    config = config_of(capture, tmp_path)
    with pytest.raises(StoppedError):
        trained(config, [Stopper()])
    before = [StreamReader(path) for path in run_targets(config)]
    assert [(reader.num_frames, reader.manifest.live) for reader in before] == [(2, True)] * 2
    after = [StreamReader(p) for p in run_targets(trained(replace(config, resume=True)))]
    assert [reader.records for reader in after] == [reader.records for reader in streams]


def test_a_layer_without_a_gaussian_is_refused() -> None:
    assert layer_slots((0.35, 0.15, 0.2, 0.3), 4) == (1, 1, 1, 1)
    with pytest.raises(InvalidError, match="2 Gaussians in a slice leave a layer without any"):
        layer_slots((0.35, 0.15, 0.2, 0.3), 2)
