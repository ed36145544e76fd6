"""Kernels, each time in a new process: within bounds, compiled once, usable without a cache,
and loaded only where one is run."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.commands import ROOT

HOSTILE = """
import sys
from tests.support.slots.hostile_slots import hostile_slots
print(hostile_slots(int(sys.argv[1])))
"""

# Kernels of the codec are enough, because all kernels use the same decorator.
KERNELS = """
from codec.kernel import Kernel
from codec.lattice import morton, orientation, quantise
from codec.lattice import lattice
from codec.slots import mask, rangecoder, residual
from codec.stream import wholeslice
from tests.support.slots.hostile_slots import hostile_slots
from tests.support.objects import new_chunk
assert hostile_slots(20)
assert new_chunk(0, 20).data
modules = (wholeslice, morton, orientation, quantise, lattice, mask, rangecoder, residual)
values = [value for module in modules for value in vars(module).values()]
kernels = {value.dispatcher if isinstance(value, Kernel) else value for value in values
           if hasattr(value, "py_func") or isinstance(value, Kernel)}
assert all(kernel.targetoptions["nogil"] for kernel in kernels)
compiled = sum(sum(kernel.stats.cache_misses.values()) for kernel in kernels)
loaded = sum(sum(kernel.stats.cache_hits.values()) for kernel in kernels)
print(len(kernels), compiled, loaded)
"""

# Root may write anywhere, so numba gets the result of a place where no user may.
NO_PLACE = """
from numba.core import caching
def refuse(locator):
    raise PermissionError(13, "nowhere")
caching._CacheLocator.ensure_cache_path = refuse
"""

# Compiled code needs more, its index less.
NO_ROOM = """
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, (4_000, resource.RLIM_INFINITY))
"""

SYNTH = """
import sys
from pathlib import Path
import trainer.__main__
from trainer.synth.film import SynthConfig, synthesise
out = Path(sys.argv[1])
synthesise(SynthConfig(out, frames=1, cameras=2, held_out=0, width_px=16, height_px=16, points=8))
print(len(list(out.glob("*.mp4"))))
"""


def output_of(program: str, *arguments: str, **environment: str) -> list[int]:
    """The numbers that `program` prints; warnings are errors, progress output is allowed."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", program, *arguments],
        cwd=ROOT,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        timeout=200,
    )
    assert done.returncode == 0, done.stderr
    assert "arning" not in done.stderr
    return [int(word) for word in done.stdout.split()]


@pytest.mark.parametrize(
    ("mode", "count"),
    [
        pytest.param("NUMBA_BOUNDSCHECK", 6000, marks=pytest.mark.slow),
        ("NUMBA_DISABLE_JIT", 1000),
    ],
)
def test_hostile_chunks_never_lead_a_kernel_out_of_bounds(
    mode: str, count: int, tmp_path: Path
) -> None:
    """Normally a kernel reads beyond an array silently; in these modes it raises IndexError."""
    # A separate cache, because numba does not distinguish code with and without bounds checks.
    environment = {mode: "1", "NUMBA_CACHE_DIR": str(tmp_path)}
    (taken,) = output_of(HOSTILE, str(count), **environment)
    assert 0.1 * count < taken < 0.9 * count


def test_kernels_are_compiled_once(tmp_path: Path) -> None:
    kernels, compiled, loaded = output_of(KERNELS, NUMBA_CACHE_DIR=str(tmp_path))
    assert kernels >= 20
    assert compiled > 0
    assert loaded == 0
    _, compiled, loaded = output_of(KERNELS, NUMBA_CACHE_DIR=str(tmp_path))
    assert compiled == 0
    assert loaded > 0


def test_kernels_work_where_nothing_can_be_kept() -> None:
    _, compiled, loaded = output_of(NO_PLACE + KERNELS)
    assert compiled > 0
    assert loaded == 0


@pytest.mark.slow
def test_kernels_work_on_a_full_disk_and_leave_nothing_broken(tmp_path: Path) -> None:
    _, compiled, _ = output_of(NO_ROOM + KERNELS, NUMBA_CACHE_DIR=str(tmp_path))
    assert compiled > 0
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]
    _, again, loaded = output_of(KERNELS, NUMBA_CACHE_DIR=str(tmp_path))
    assert (again, loaded) == (compiled, 0)


@pytest.mark.slow
def test_a_capture_is_made_where_nothing_can_be_kept(tmp_path: Path) -> None:
    """The modules of the trainer's commands create their kernels at import."""
    assert output_of(NO_PLACE + SYNTH, str(tmp_path / "made")) == [2]


def names(file: Path) -> set[str]:
    """Every name that the module `file` imports or uses."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    return {
        getattr(node, kind)
        for node in ast.walk(tree)
        for kind in ("name", "attr", "id")
        if isinstance(getattr(node, kind, None), str)
    }


def test_only_one_module_names_numbas_compiler() -> None:
    """All other modules use its decorator, which works where no kernel can be cached."""
    modules = [
        file
        for folder in ("codec", "trainer", "server", "player", "bench", "fuzz", "tests")
        for file in sorted((ROOT / folder).rglob("*.py"))
    ]
    assert len(modules) > 100
    naming = [str(m.relative_to(ROOT)) for m in modules if names(m) & {"jit", "njit"}]
    assert naming == ["codec/kernel.py"]


INNER = """
from codec.kernel import kernel
STEP = {step}
@kernel(inline="always")
def inner(x):
    return x + {added}
"""

OUTER = """
from codec.kernel import kernel
from inner import STEP, inner
@kernel()
def between(x):
    return inner(x)
@kernel()
def outer(x):
    return between(x) * STEP
print(outer(3), sum(outer.stats.cache_hits.values()))
"""


def test_a_change_in_a_kernel_or_constant_of_another_file_is_noticed(tmp_path: Path) -> None:
    def told(step: int, added: int) -> str:
        (tmp_path / "inner.py").write_text(INNER.format(step=step, added=added))
        done = subprocess.run(
            # -B: Python would use stale bytecode for a file of equal size and time in seconds.
            [sys.executable, "-B", "-c", "import outer"],
            env={**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"},
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=True,
        )
        return done.stdout

    (tmp_path / "outer.py").write_text(OUTER)
    assert told(step=10, added=1) == "40 0\n"
    assert told(step=10, added=1) == "40 1\n"
    assert told(step=10, added=2) == "50 0\n"
    assert told(step=20, added=2) == "100 0\n"
    assert told(step=20, added=2) == "100 1\n"


@pytest.mark.parametrize(
    "module", ["codec", "server.__main__", "player.config", "trainer.__main__"]
)
def test_numba_is_not_loaded_before_a_kernel_is_run(module: str) -> None:
    program = f"import sys, {module}; print(int('numba' in sys.modules))"
    assert output_of(program) == [0]
