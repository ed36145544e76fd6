"""Settings of a run round-trip through JSON, and invalid ones are an error."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from trainer.fit.config import FitConfig
from trainer.lease.leases import LeaseConfig
from trainer.run.config import TrainConfig
from trainer.run.preset import PRESETS
from trainer.run.storedconfig import config_from_json, config_to_json

ROOT = Path("/somewhere")
OTHER = TrainConfig(
    ROOT / "capture", ROOT / "stream", frames="3:9", scale=0.5, near_m=0.25, layers=(0.5, 0.5),
    whole_slices=True, raw_stream=ROOT / "raw", log=ROOT / "log", title="ünï",
    fit=FitConfig(num_gs=30, swin_size=3, lease=LeaseConfig(active_share=0.5)),
)  # fmt: skip
CONFIGS = [OTHER, *(make(ROOT / "capture", ROOT / "stream") for make in PRESETS.values())]


@pytest.mark.parametrize("config", CONFIGS, ids=range(len(CONFIGS)))
def test_settings_come_back(config: TrainConfig) -> None:
    text = json.dumps(config_to_json(config))
    assert config_from_json(TrainConfig, json.loads(text)) == config


def test_paths_hold_from_any_folder() -> None:
    stored = config_to_json(replace(OTHER, log=Path("log.jsonl")))
    assert stored["log"] == str(Path.cwd() / "log.jsonl")


@pytest.mark.parametrize(
    "values", [{"no_such": 1}, {"capture": 3}, {"capture": "c", "fit": {"seed": -1}}, {"fit": 1}]
)
def test_what_makes_no_settings_is_an_error(values: dict[str, Any]) -> None:
    with pytest.raises((TypeError, ValueError)):
        config_from_json(TrainConfig, {"capture": "c", "stream": "s", **values})
