"""The kernels compiled ahead are all that training runs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.commands import ROOT
from tests.support.tiny_capture import write_dynerf

# A separate process, because other tests compile kernels, too.
PROGRAM = """
import sys
from pathlib import Path
from numba.core.dispatcher import Dispatcher
from rich.console import Console
from trainer.fit.config import FitConfig
from trainer.run.config import TrainConfig
from trainer.run.job import train_stream
from trainer.run.warm import compile_kernels

def known():
    return {
        (name, at, signature)
        for name, module in list(sys.modules.items())
        if name.split(".")[0] in ("trainer", "player", "codec")
        for at, value in vars(module).items()
        if isinstance(value, Dispatcher)
        for signature in value.signatures
    }

capture, stream, sh_degree = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
compile_kernels(sh_degree)
before = known()
assert len(before) > 20, before
fit = FitConfig(
    num_gs=60, swin_size=2, sh_degree=sh_degree, genesis_iterations=101, settle_rounds=1,
    window_iterations=101, scene_flow=True,
)
for whole_slices in (False, True):
    job = TrainConfig(capture, stream / str(whole_slices), whole_slices=whole_slices, fit=fit)
    train_stream(job, Console(quiet=True))
for name, at, signature in sorted(known() - before, key=str):
    print(name, at, signature)
"""


@pytest.mark.parametrize("sh_degree", [0, 1, 3])
def test_training_compiles_nothing_that_was_not_compiled_ahead(
    sh_degree: int, tmp_path: Path
) -> None:
    write_dynerf(tmp_path / "capture", num_cameras=9, num_frames=4)  # no warning
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, tmp_path / "capture", tmp_path / "out", str(sh_degree)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
