"""Presets: named defaults of swings-train, which every option still overrides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, make_dataclass
from typing import Any, get_args, get_type_hints

from codec.profiles.profile import Profile
from trainer.fit.config import FitConfig
from trainer.fit.mcmc import McmcConfig
from trainer.fit.optimiser import OptimiserConfig

from .config import Preset, TrainConfig

PRESETS: Mapping[Preset, Mapping[str, Any]] = {
    # The defaults: what two cores train in minutes. Measured in docs/RESULTS.md.
    "cpu": {},
    # A first look at a capture: a third of the iterations and half of the Gaussians of `cpu`.
    "fast": {
        "fit": FitConfig(num_gs=10_000, genesis_iterations=1_600, window_iterations=250),
    },
    # The paper's setting, made for a GPU: section 8.1 and, where it is silent, 3DGS-MCMC, on which
    # it builds.
    "paper": {
        "fit": FitConfig(
            num_gs=200_000,  # 8.1
            swin_size=5,  # 8.1
            sh_degree=1,  # 8.1
            genesis_iterations=30_000,  # 8.1
            window_iterations=2_000,  # 8.1
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
            ),
        ),
        "point_share": 1.0,  # 3DGS: a capture's points and nothing else, as far as they go
        "rank": "opacity",  # 5.5
        "profile": Profile.PAPER,  # 5.6.2
    },
}


def config_type(arguments: Sequence[str]) -> type[TrainConfig]:
    """TrainConfig with the defaults of the preset that the command line names, if any.

    An unknown name is left to the parser to refuse.
    """
    for at, argument in enumerate(arguments):
        name, equals, value = argument.partition("=")
        if name == "--preset":
            value = value if equals else "".join(arguments[at + 1 : at + 2])
            for preset in get_args(Preset):
                if value == preset:
                    return _with_defaults(preset)
    return TrainConfig


def _with_defaults(preset: Preset) -> type[TrainConfig]:
    hints = get_type_hints(TrainConfig, include_extras=True)
    defaults = {"preset": preset, **PRESETS[preset]}
    # Frozen dataclasses of plain values: one instance may serve all, but a field's default must be
    # hashable or come from a factory.
    fields = [
        (name, hints[name], field(default_factory=lambda value=value: value))  # type: ignore[misc]
        for name, value in defaults.items()
    ]
    made = make_dataclass("TrainConfig", fields, bases=(TrainConfig,), frozen=True)
    made.__doc__ = TrainConfig.__doc__
    return made
