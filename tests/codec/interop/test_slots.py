"""Files and streams of version 2: nothing hidden is exported, and what lasts is sent once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from codec.errors import InvalidError
from codec.interop.exporting import export_stream
from codec.interop.formats import SplatFormat, read_splats, write_splats
from codec.sequence.importing import ImportOptions, import_stream
from codec.profiles.profile import Profile
from codec.slots.lattice import dequantise, quantise
from codec.splats import Splats
from codec.stream import StreamReader
from codec.stream.layers import Rank
from codec.tools.audit import summarise, verify_stream
from codec.tools.slotcensus import count_slots
from tests.goldens.slots_decoder import Gaussian, to_floats
from tests.goldens.slots_folder import StreamFolder, state_at
from tests.support.commands import run, run_ok
from tests.support.drawn import same
from tests.support.slots.folder import write_slots
from tests.support.slots.updates import small_layout
from tests.support.trained_like import trained_like_splats

LATTICE = ImportOptions(profile=Profile.LATTICE)
LAYOUT = small_layout(3, (9, 6), 1, 4)


def save(path: Path, splats: Splats) -> Path:
    path.parent.mkdir(exist_ok=True)
    write_splats(path, splats, SplatFormat.PLY)
    return path


def by_position(splats: Splats) -> Splats:
    return splats.take(np.lexsort(splats.means.T))


@pytest.mark.parametrize("layers", [1, 2])
def test_what_shows_is_exported_and_nothing_else(layers: int, tmp_path: Path) -> None:
    """By the plain decoder: Gaussians that have started, and no empty slot."""
    write_slots(tmp_path / "s", 10, LAYOUT)
    hidden = 0
    for frame in range(10):
        shape = StreamFolder(tmp_path / "s").shape
        held = [
            (slot, lattice)
            for lane in state_at(tmp_path / "s", frame, layers)
            for row, lattice in zip(lane[:layers], shape.lattice[:layers], strict=True)
            for slot in row
        ]
        shown = [
            to_floats(slot, lattice)
            for slot, lattice in held
            if isinstance(slot, Gaussian) and slot.start <= frame
        ]
        hidden += len(held) - len(shown)
        means = np.array([floats.mean for floats in shown], np.float32).reshape(-1, 3)
        for format in SplatFormat:
            [out] = export_stream(
                tmp_path / "s", tmp_path / f"o.{format}", frame, None, None, layers
            )
            found = read_splats(out)
            assert len(found) == len(shown)
            if format is SplatFormat.PLY:
                assert (by_position(found).means == means[np.lexsort(means.T)]).all()
                assert np.isfinite(found.logit_opacities).all()
    assert hidden > 20


@pytest.mark.parametrize("sh_degree", [0, 2])
def test_a_still_model_is_its_snapshot(sh_degree: int, tmp_path: Path) -> None:
    splats = trained_like_splats(300, sh_degree=sh_degree)
    options = replace(LATTICE, rank=Rank.GIVEN)
    made = import_stream(save(tmp_path / "m" / "model.ply", splats), tmp_path / "s", options)
    assert (made.version, made.swin_size, made.num_gs) == (2, 1, 300)
    assert made.slots == (105, 45, 60, 90)
    assert verify_stream(tmp_path / "s").num_frames == 1
    states, fits = quantise(splats, made.lattice[0])
    found = StreamReader(tmp_path / "s").active_splats(0, 4)
    assert fits.sum() > 250
    inside, escaped = np.flatnonzero(fits), np.flatnonzero(~fits)
    assert same(found.take(inside), dequantise(states, made.lattice[0]).take(inside))
    assert same(found.take(escaped), splats.take(escaped))


def test_what_lasts_in_a_sequence_is_sent_once(tmp_path: Path) -> None:
    """100 move and 100 stay; two are too far for the lattice, of which one comes near."""
    first = trained_like_splats(200, sh_degree=1)
    means = first.means.copy()
    means[0], means[1] = 1e9, 2e9
    for number in range(4):
        moved = means.copy()
        moved[100:] += np.float32(0.05 * number)
        if number >= 2:
            moved[0] = 0.5
        save(tmp_path / "seq" / f"f{number}.ply", replace(first, means=moved))
    made = import_stream(tmp_path / "seq", tmp_path / "s", LATTICE)
    step_m = made.lattice[0].position_m
    assert verify_stream(tmp_path / "s").num_frames == 4
    counts = count_slots(StreamReader(tmp_path / "s")).statuses.sum(axis=1)
    for frame, (kept, ended, predicted, new) in enumerate(counts.tolist()):
        if frame:
            assert (kept, ended, predicted, new) == (100 - (frame == 2), 0, 100, int(frame == 2))
    assert counts[1:, 0].sum() == 299
    for frame in range(4):
        source = read_splats(tmp_path / "seq" / f"f{frame}.ply")
        found = StreamReader(tmp_path / "s").active_splats(frame, 4)
        assert len(found) == 200
        for a, b in zip(np.sort(source.means, 0).T, np.sort(found.means, 0).T, strict=True):
            assert (abs(a - b) <= step_m * 0.501 + abs(a) * 1e-6).all()
    told = summarise(tmp_path / "s")
    assert told.slots is not None
    assert sum(told.slots.new) == pytest.approx(1 / 3)


def test_few_gaussians_are_one_layer(tmp_path: Path) -> None:
    made = import_stream(
        save(tmp_path / "m" / "1.ply", trained_like_splats(1)), tmp_path / "s", LATTICE
    )
    assert made.slots == (1,)
    verify_stream(tmp_path / "s")


def test_files_that_do_not_fit_together_are_refused(tmp_path: Path) -> None:
    save(tmp_path / "seq" / "1.ply", trained_like_splats(30))
    save(tmp_path / "seq" / "2.ply", trained_like_splats(31))
    with pytest.raises(InvalidError, match=r"2\.ply: 31 Gaussians where 1\.ply has 30"):
        import_stream(tmp_path / "seq", tmp_path / "s", LATTICE)
    save(tmp_path / "none" / "1.ply", trained_like_splats(30).take(slice(0, 0)))
    with pytest.raises(InvalidError, match=r"1\.ply: holds no Gaussian"):
        import_stream(tmp_path / "none", tmp_path / "s", LATTICE)
    assert not (tmp_path / "s").exists()
    assert import_stream(tmp_path / "seq", tmp_path / "s", ImportOptions()).version == 1


def test_the_commands(tmp_path: Path) -> None:
    model = save(tmp_path / "m" / "model.ply", trained_like_splats(60))
    told = run_ok("swings-stream", "import", model, tmp_path / "s", "--profile", "lattice")
    assert told == f"{tmp_path}/s: model.ply, up to 60 Gaussians a frame, SH degree 0, lattice\n"
    out = tmp_path / "out.spz"
    run_ok("swings-stream", "export", tmp_path / "s", out, "--frame", 0)
    assert len(read_splats(out)) == 60
    done = run("swings-stream", "export", tmp_path / "s", out, "--frame", 1)
    assert done.returncode == 1
