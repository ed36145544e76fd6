"""swings-synth, swings-capture, swings-train and swings-eval: parse, build a config, run."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from rich.console import Console

from codec.console import run_command, say

# Threads that wait must not spin: beside other work on few cores that costs more than it saves.
# It has to be said before the first parallel kernel runs.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

# What a command needs is imported when it runs: `--help` must not wait for numba or matplotlib.
if TYPE_CHECKING:
    from trainer.run.config import TrainConfig


def _train(config: TrainConfig) -> None:
    console = Console(stderr=True)
    if config.check is not None:
        from trainer.run.check import check_capture

        return say("\n".join(check_capture(config, console)))
    if config.ray is not None:
        from trainer.parts.raydriver import train_in_parts

        train_in_parts(config, config.ray, console)
    else:
        from trainer.run.job import train_stream
        from trainer.run.warm import start_over_if_compiled

        # bytes must not depend on whether this run compiles the kernels
        train_stream(config, console, lambda: start_over_if_compiled(config.fit.sh_degree, console))
    return say(str(config.target))


def synth() -> None:
    from trainer.synth.film import SynthConfig, synthesise

    def film(config: SynthConfig) -> None:
        if config.plain is not None:
            from trainer.synth.plain import TRUTH_NAME, synthesise_plain

            synthesise_plain(config)
            return say(f"{config.out}: {config.cameras} videos, and {TRUTH_NAME}")
        synthesise(config)
        cameras = f"{config.cameras} cameras, {config.held_out} of them held out"
        return say(f"{config.out}: {cameras}, {config.frames} frames at {config.fps:g} a second")

    run_command(SynthConfig, film, "swings-synth", "Generates a procedural capture to try swings.")


def train() -> None:
    from trainer.run.config import TrainConfig, parse_with_preset

    what = "Trains a capture into a stream."
    run_command(TrainConfig, _train, "swings-train", what, parse_with_preset)


def capture() -> None:
    from trainer.calibrate.capturecommand import CaptureCommand, run_capture

    what = "Makes a capture of videos: calibrates their cameras, or imports a calibration."
    run_command(CaptureCommand, run_capture, "swings-capture", what)


def evaluate() -> None:
    from trainer.score.evaluate import EvaluateConfig
    from trainer.score.evaluatecommand import run_evaluation

    run_command(
        EvaluateConfig, run_evaluation, "swings-eval", "Scores a stream against its capture."
    )
