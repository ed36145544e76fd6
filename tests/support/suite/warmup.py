"""Compiles the kernels that the tests run, so that several processes need not compile them each.

`python -m tests.support.suite.warmup`. Numba caches compiled code beside the sources, so a second
run takes a few seconds.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from tests.support.commands import ROOT


def train() -> None:
    """Compiles the kernels of training and of its output."""
    from trainer.run.warm import compile_kernels

    compile_kernels(sh_degree=1)


def film_and_play() -> None:
    """Compiles the kernels of the synthetic scene, and of a player that draws on the CPU."""
    from player.rehearsal import rehearse
    from player.render.renderer import RendererKind
    from trainer.synth.film import SynthConfig, synthesise

    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "capture"
        synthesise(SynthConfig(target, frames=1, cameras=5, width_px=32, height_px=32, points=50))
    rehearse(RendererKind.CPU)


JOBS = (train, film_and_play)


def main() -> None:
    if sys.argv[1:]:
        return next(job for job in JOBS if job.__name__ == sys.argv[1])()
    sys.stderr.write("compiling kernels (a minute on two cores, once after a clone)\n")
    command = [sys.executable, "-m", "tests.support.suite.warmup"]
    processes = [subprocess.Popen([*command, job.__name__], cwd=ROOT) for job in JOBS]
    sys.exit(max(process.wait() for process in processes))


if __name__ == "__main__":
    main()
