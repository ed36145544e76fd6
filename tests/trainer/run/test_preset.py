"""Presets change defaults only: every option still overrides them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from codec.profiles.profile import Profile
from tests.support.commands import run, run_ok
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
    assert config.profile is Profile.PAPER
    wanted = PRESETS["paper"](Path("capture"), Path("stream")).fit
    assert config.fit == replace(
        wanted, window_iterations=77, mcmc=replace(wanted.mcmc, scale_reg=0.5)
    )
    assert config.fit.num_gs == 200_000


def test_without_a_preset_the_defaults_are_those_of_cpu() -> None:
    assert asdict(parse()) == asdict(parse("--preset", "cpu"))
    assert parse().fit == FitConfig()
    assert parse("--preset", "fast").fit.window_iterations < FitConfig().window_iterations


def test_an_unknown_preset_is_refused(tmp_path: Path) -> None:
    done = run("swings-train", tmp_path, tmp_path / "out", "--preset", "gpu")
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
