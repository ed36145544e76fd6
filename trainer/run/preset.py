"""Presets: named defaults of swings-train, which every option still overrides."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from codec.console import cli, split_option
from codec.storage.openstorage import parse_target
from trainer.errors import CheckpointError
from trainer.fit.config import FitConfig
from trainer.fit.mcmc import McmcConfig
from trainer.step.optimiser import OptimiserConfig

from .checkpoint import read_options
from .config import LOCAL, Preset, TrainConfig, default_work
from .storedconfig import config_from_json

PRESETS: Mapping[Preset, Callable[..., TrainConfig]] = {
    # The defaults: what two cores train in minutes. Measured in docs/RESULTS.md.
    "cpu": TrainConfig,
    # A first look at a capture: a third of the iterations and half of the Gaussians of `cpu`.
    "fast": partial(
        TrainConfig,
        preset="fast",
        longest_px=480,
        fit=FitConfig(
            num_gs=10_000,
            genesis_iterations=1_500,
            settle_rounds=8,
            window_iterations=150,
            scene_flow=True,  # so few iterations leave a ghost where a ball was
        ),
    ),
    # Two cores train 150 frames of 640x360 with it in an hour. docs/RESULTS.md.
    "fine": partial(
        TrainConfig,
        preset="fine",
        longest_px=None,
        fit=FitConfig(
            num_gs=24_000,
            settle_rounds=90,
            window_iterations=450,
            window_coarse_share=0.4,  # saves a fifth of the time, costs some flicker
            scene_flow=True,
            settle_prefix_share=0.1,
            prefix_share=0.08,
            mcmc=McmcConfig(renew_share=0.03),
        ),
    ),
    # What a GPU should train in seconds a frame at 1352x1014, the size at which DyNeRF captures are
    # compared. Not measured: see docs/RESULTS.md for the command.
    "gpu": partial(
        TrainConfig,
        preset="gpu",
        backend="auto",
        longest_px=1352,
        fit=FitConfig(
            num_gs=200_000,
            genesis_iterations=9_000,
            settle_rounds=20,
            window_iterations=600,
        ),
    ),
    # The paper's setting, made for a GPU: section 8.1 and, where it is silent, 3DGS-MCMC, on which
    # it builds.
    "paper": partial(
        TrainConfig,
        preset="paper",
        longest_px=None,
        fit=FitConfig(
            num_gs=200_000,  # 8.1
            swin_size=5,  # 8.1
            sh_degree=1,  # 8.1
            genesis_iterations=30_000,  # 8.1
            window_iterations=2_000,  # 8.1
            settle_rounds=0,  # not in the paper
            calm_from=1.0,  # not in the paper
            coarse_share=0.0,  # not in the paper
            newest_share=0.0,  # Algorithm 1: frames of the window evenly
            colour_lr=0.0,  # not in the paper
            optimiser=OptimiserConfig(
                window_means_lr=1.6e-4,  # 3DGS-MCMC, again for every window
                window_means_lr_end=1.6e-6,
                age_scaling="gradient",  # 4.5.1
            ),
            mcmc=McmcConfig(
                renew_share=0.0,  # not in the paper
                opacity_reg=0.02,  # 8.1
                scale_reg=0.01,  # 8.1
                max_scale=0.0,  # not in the paper
            ),
        ),
        point_share=1.0,  # 3DGS: a capture's points and nothing else, as far as they go
        rank="opacity",  # 5.5
        whole_slices=True,
    ),
}
"""TrainConfig with other defaults."""


def parse_with_preset(
    config_type: Callable[..., TrainConfig], args: Sequence[str], **options: Any
) -> TrainConfig:
    """Calls `cli` with the defaults of the preset that `args` name, if any; where they ask to
    resume a run, with that run's settings.

    An unknown name is left to tyro to refuse.
    """
    config: TrainConfig
    args = _with_address(args)
    before = _resumed(args) if "--resume" in args else None
    if before is not None:
        config = cli(TrainConfig, default=before, args=args, **options)
        return config
    preset, _ = split_option(args, "--preset", nargs="?")
    config = cli(PRESETS.get(preset, config_type), args=args, **options)
    return config


def _with_address(args: Sequence[str]) -> list[str]:
    """`args` with the address that --ray leaves out."""
    given = list(args)
    if "--ray" in given:
        after = given.index("--ray") + 1
        if after == len(given) or given[after].startswith("-"):
            given.insert(after, LOCAL)
    return given


def _resumed(args: Sequence[str]) -> TrainConfig | None:
    """The settings of the run whose folder is among `args`; None if there is none, or if they
    cannot be read, which is reported later."""
    # Before parsing, which needs them: of what is given, a part may be wrong without the rest.
    folders = [default_work(parse_target(word)) for word in args if not word.startswith("-")]
    try:
        kept = next((options for f in folders if (options := read_options(f)) is not None), None)
        return None if kept is None else config_from_json(TrainConfig, kept)
    except (CheckpointError, TypeError, ValueError):
        return None
