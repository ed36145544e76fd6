"""The settings of a run: presets change defaults only, JSON keeps all, and none may contradict."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest

from codec.errors import InvalidError
from tests.support.commands import run, run_ok
from tests.support.hostile import refused
from trainer.fit.config import FitConfig
from trainer.lease.leases import LeaseConfig
from trainer.run.config import (
    PRESETS,
    TrainConfig,
    config_from_json,
    config_to_json,
    parse_with_preset,
)

ROOT = Path("/somewhere")
OTHER = TrainConfig(
    ROOT / "capture", ROOT / "stream", frames="3:9", scale=0.5, near_m=0.25, layers=(0.5, 0.5),
    whole_slices=True, raw_stream=ROOT / "raw", log=ROOT / "log", title="ünï",
    fit=FitConfig(num_gs=30, swin_size=3, lease=LeaseConfig(active_share=0.5)),
)  # fmt: skip
CONFIGS = [OTHER, *(make(ROOT / "capture", ROOT / "stream") for make in PRESETS.values())]


def parse(*arguments: str) -> TrainConfig:
    return parse_with_preset(TrainConfig, args=["capture", "stream", *arguments])


def test_a_preset_gives_the_defaults_and_options_override_them() -> None:
    wanted = PRESETS["paper"](Path("capture"), Path("stream")).fit
    wanted = replace(wanted, window_iterations=77, mcmc=replace(wanted.mcmc, scale_reg=0.5))
    more = "--window-iterations", "77", "--mcmc.scale-reg", "0.5"
    for spelling in ("--preset paper", "--preset=paper", "--preset fast --preset paper"):
        config = parse(*spelling.split(), *more)
        assert (config.preset, config.whole_slices, config.fit) == ("paper", True, wanted)


def test_presets_are_what_their_names_say() -> None:
    assert asdict(parse()) == asdict(parse("--preset", "cpu"))
    fast, cpu, fine = (parse("--preset", name).fit for name in ("fast", "cpu", "fine"))
    assert cpu == FitConfig()
    assert fast.window_iterations < cpu.window_iterations < fine.window_iterations
    assert fast.iterations(0) < cpu.iterations(0) < fine.iterations(0)
    assert [PRESETS[name]("c", "s").longest_px for name in PRESETS] == [640, 480, None, 1352, None]
    paper = parse("--preset", "paper")
    fit = paper.fit
    assert (paper.whole_slices, paper.rank) == (True, "opacity")
    assert (fit.num_gs, fit.swin_size, fit.sh_degree) == (200_000, 5, 1)
    assert (fit.iterations(0), fit.window_iterations) == (30_000, 2_000)
    # Features that the paper lacks: settling, calm, renewal.
    assert (fit.settle_rounds, fit.calm_from, fit.mcmc.renew_share) == (0, 1.0, 0.0)


def test_help_shows_the_defaults_of_a_preset_and_completion_knows_every_option() -> None:
    told = " ".join(run_ok("swings-train", "--preset", "paper", "--help").split())
    assert "default: 200000)" in told
    assert "(default: paper)" in told
    completion = run_ok("swings-train", "--tyro-print-completion", "bash", "--preset", "paper")
    assert "--genesis-iterations" in completion


@pytest.mark.parametrize("config", CONFIGS, ids=range(len(CONFIGS)))
def test_settings_come_back(config: TrainConfig) -> None:
    text = json.dumps(config_to_json(config))
    assert config_from_json(TrainConfig, json.loads(text)) == config
    # Paths hold from any folder.
    stored = config_to_json(replace(config, log=Path("log.jsonl")))
    assert stored["log"] == str(Path.cwd() / "log.jsonl")


@pytest.mark.parametrize(
    "values", [{"no_such": 1}, {"capture": 3}, {"capture": "c", "fit": {"seed": -1}}, {"fit": 1}]
)
def test_what_makes_no_settings_is_an_error(values: dict[str, Any]) -> None:
    with pytest.raises((TypeError, ValueError)):
        config_from_json(TrainConfig, {"capture": "c", "stream": "s", **values})


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"audio": Path("a.wav"), "silent": True}, "cannot be combined with --silent"),
        *(({"scale": scale}, "choose above 0, at most 1") for scale in (2.0, 0.0, float("nan"))),
        ({"worker_cpus": 0}, "worker_cpus 0"),
        ({"worker_gpus": -1}, "worker_gpus -1"),
    ],
)
def test_settings_that_cannot_be_are_refused(values: dict[str, Any], message: str) -> None:
    refused(InvalidError, message, TrainConfig, "capture", "stream", **values)


@pytest.mark.parametrize(
    ("more", "word"),
    [
        (("--raw-stream", "raw"), "--raw-stream"),
        (("--rank", "opacity"), "--rank opacity"),
        (("--rank", "coverage"), "--rank coverage"),
        (("--no-whole-slices", "--preset", "paper"), "--rank opacity"),
    ],
)
def test_what_only_whole_slices_do_needs_them_in_any_preset(more: Sequence[str], word: str) -> None:
    refused(InvalidError, f"{word} .*--whole-slices", parse(*more).check_slices)
    for preset in ("fast", "paper"):
        parse(*more, "--preset", preset, "--whole-slices").check_slices()


def test_contradictions_are_refused_before_anything_is_read(tmp_path: Path) -> None:
    for code, words, told in (
        (1, ("--rank", "opacity"), "swings-train: --rank opacity"),
        (2, ("--preset", "giant"), "paper"),
    ):
        done = run("swings-train", "nothing", tmp_path / "out", *words, folder=tmp_path)
        assert done.returncode == code
        assert told in " ".join(done.stderr.split())
    assert not list(tmp_path.iterdir())
