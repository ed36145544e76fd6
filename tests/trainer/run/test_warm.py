"""The kernels compiled ahead are all that training runs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from numba.core.dispatcher import Dispatcher

from tests.support.commands import environment
from tests.support.tiny_capture import write_dynerf
from tests.support.trainings import train_here
from trainer.run.warm import compile_kernels

TINY = (
    "--num-gs", 60, "--swin-size", 2, "--genesis-iterations", 101, "--settle-rounds", 1,
    "--window-iterations", 101, "--scene-flow",
)  # fmt: skip


def known() -> set[tuple[str, str, object]]:
    """The kernels that this process has loaded or compiled, with the types of their arguments."""
    return {
        (name, at, signature)
        for name, module in list(sys.modules.items())
        if name.split(".")[0] in ("trainer", "player", "codec")
        for at, value in vars(module).items()
        if isinstance(value, Dispatcher)
        for signature in value.signatures
    }


def main() -> None:
    """In an interpreter of its own, because other processes have loaded kernels."""
    capture, stream, sh_degree = sys.argv[1:]
    compile_kernels(int(sh_degree))
    before = known()
    assert len(before) > 20, before
    for way in ("--whole-slices", "--no-whole-slices"):
        train_here(capture, f"{stream}{way}", way, "--sh-degree", sh_degree, *TINY)
    sys.stdout.writelines(f"{one}\n" for one in sorted(known() - before, key=str))


@pytest.mark.parametrize("sh_degree", [0, pytest.param(1, marks=pytest.mark.deep), 3])
def test_training_compiles_nothing_that_warm_did_not(sh_degree: int, tmp_path: Path) -> None:
    write_dynerf(tmp_path / "capture", num_cameras=9, num_frames=3)  # no warning
    code = "from tests.trainer.run.test_warm import main; main()"
    words = tmp_path / "capture", tmp_path / "out", sh_degree
    argv = [sys.executable, "-c", code, *map(str, words)]
    done = subprocess.run(argv, env=environment(), capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
