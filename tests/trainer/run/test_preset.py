"""Presets change defaults only: every option still overrides them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from codec.slots.update import NEW
from codec.stream import StreamReader
from codec.tools.slotcensus import count_slots
from tests.support.commands import run, run_ok
from tests.support.tiny_capture import write_dynerf
from trainer.fit.config import FitConfig
from trainer.run.config import TrainConfig
from trainer.run.preset import PRESETS, parse_with_preset


def parse(*arguments: str) -> TrainConfig:
    return parse_with_preset(TrainConfig, args=["capture", "stream", *arguments])


@pytest.mark.parametrize(
    "spelling",
    [["--preset", "paper"], ["--preset=paper"], ["--preset", "fast", "--preset", "paper"]],
)
def test_a_preset_gives_the_defaults_and_options_override_them(spelling: Sequence[str]) -> None:
    config = parse(*spelling, "--window-iterations", "77", "--mcmc.scale-reg", "0.5")
    assert config.preset == "paper"
    assert config.whole_slices
    wanted = PRESETS["paper"](Path("capture"), Path("stream")).fit
    assert config.fit == replace(
        wanted, window_iterations=77, mcmc=replace(wanted.mcmc, scale_reg=0.5)
    )
    assert config.fit.num_gs == 200_000


def test_without_a_preset_the_defaults_are_those_of_cpu() -> None:
    assert asdict(parse()) == asdict(parse("--preset", "cpu"))
    assert parse().fit == FitConfig()
    fast, cpu, fine = (parse("--preset", name).fit for name in ("fast", "cpu", "fine"))
    assert fast.window_iterations < cpu.window_iterations < fine.window_iterations
    assert fast.iterations(0) < cpu.iterations(0) < fine.iterations(0)


def test_an_unknown_preset_is_refused(tmp_path: Path) -> None:
    done = run("swings-train", tmp_path, tmp_path / "out", "--preset", "giant")
    assert done.returncode == 2
    assert "cpu" in done.stderr
    assert "paper" in done.stderr
    assert not (tmp_path / "out").exists()


def test_help_shows_the_defaults_of_a_preset_and_completion_knows_every_option() -> None:
    for arguments, default in (((), 20_000), (("--preset", "paper"), 200_000)):
        told = run_ok("swings-train", *arguments, "--help")
        assert f"default: {default})" in told
        assert "(default: paper)" in told or not arguments
    completion = run_ok("swings-train", "--tyro-print-completion", "bash", "--preset", "paper")
    assert "--genesis-iterations" in completion


def test_preset_gpu_says_its_memory_and_scales_a_large_capture(tmp_path: Path) -> None:
    config = parse("--preset", "gpu")
    assert (config.fit.num_gs, config.fit.window_iterations) == (200_000, 600)
    assert (config.longest_px, config.backend) == (1352, "auto")
    camera = write_dynerf(tmp_path / "capture", num_cameras=4, num_frames=2)[0]
    stream = tmp_path / "stream"
    done = run(
        "swings-train", tmp_path / "capture", stream, "--preset", "gpu", "--num-gs", 100,
        "--genesis-iterations", 5, "--settle-rounds", 1, "--window-iterations", 2,
        "--backend", "torch", "--torch-device", "cpu", "--longest-px", camera.width_px // 2,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert re.search(
        r"^memory: 0\.\d\d GB .* that are free on device cpu$", done.stderr, re.MULTILINE
    )
    trained = StreamReader(stream).manifest.cameras[0]
    assert (trained.width_px, trained.height_px) == (
        camera.width_px // 2, round(camera.height_px / 2),
    )  # fmt: skip


def test_preset_paper_is_the_papers_training_with_whole_slices(tmp_path: Path) -> None:
    config = parse("--preset", "paper")
    fit = config.fit
    assert (config.whole_slices, config.rank) == (True, "opacity")
    assert (fit.num_gs, fit.swin_size, fit.sh_degree) == (200_000, 5, 1)
    assert (fit.genesis_iterations, fit.window_iterations) == (30_000, 2_000)
    # Features that the paper lacks: settling, calm, renewal.
    assert (fit.settle_rounds, fit.calm_from, fit.mcmc.renew_share) == (0, 1.0, 0.0)
    assert fit.iterations(0) == 30_000
    write_dynerf(tmp_path / "capture", num_cameras=4, num_frames=3)
    stream = tmp_path / "stream"
    run_ok(
        "swings-train", tmp_path / "capture", stream, "--preset", "paper", "--num-gs", 100,
        "--genesis-iterations", 5, "--window-iterations", 2,
    )  # fmt: skip
    reader = StreamReader(stream)
    assert reader.manifest.swin_size == 5
    assert reader.manifest.slots == (7, 3, 4, 6)
    # Nothing is leased: in every slice each slot is new.
    census = count_slots(reader)
    assert (census.statuses[1:, :, NEW] == reader.manifest.slots).all()
    assert np.array_equal(census.first, 5 * np.array(reader.manifest.slots))


def test_without_a_preset_slots_last() -> None:
    config = parse()
    assert not config.whole_slices
    assert config.fit.swin_size == 1
    assert 0 < config.fit.lease.active_share < 1
