"""Kernels, each time in a new process: within bounds, compiled once, usable without a cache,
and loaded only where one is run."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.commands import ROOT

HOSTILE = """
import sys
from tests.support.slots.hostile_slots import hostile_slots
print(hostile_slots(int(sys.argv[1])))
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


def output_of(program: str, *arguments: str, **environment: str) -> list[int]:
    """The numbers that `program` prints; warnings are errors, progress output is allowed. -B:
    Python would use stale bytecode for a file of equal size and time in seconds."""
    done = subprocess.run(
        [sys.executable, "-B", "-W", "error", "-c", program, *arguments],
        cwd=ROOT,
        env=os.environ | environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "arning" not in done.stderr
    return [int(word) for word in done.stdout.split()]


@pytest.mark.parametrize(
    ("mode", "count"),
    [
        pytest.param("NUMBA_BOUNDSCHECK", 6000, marks=pytest.mark.deep),
        pytest.param("NUMBA_DISABLE_JIT", 1000, marks=pytest.mark.deep),
        ("NUMBA_DISABLE_JIT", 200),
    ],
)
def test_kernels_stay_within_bounds(mode: str, count: int, tmp_path: Path) -> None:
    """Normally a kernel reads beyond an array silently; in these modes it raises IndexError."""
    # A separate cache, because numba does not distinguish code with and without bounds checks.
    environment = {mode: "1", "NUMBA_CACHE_DIR": str(tmp_path)}
    (taken,) = output_of(HOSTILE, str(count), **environment)
    assert 0.1 * count < taken < 0.9 * count


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


@pytest.fixture
def run_outer(tmp_path: Path) -> Callable[..., list[int]]:
    """Runs OUTER; gives its result and the number of kernels that it loaded."""
    (tmp_path / "outer.py").write_text(OUTER)

    def run(step: int, added: int, before: str = "") -> list[int]:
        (tmp_path / "inner.py").write_text(INNER.format(step=step, added=added))
        return output_of(f"{before}\nimport outer", PYTHONPATH=f"{tmp_path}{os.pathsep}{ROOT}")

    return run


@pytest.mark.parametrize("before", [NO_PLACE, NO_ROOM], ids=["no place", "full disk"])
def test_nothing_is_kept(run_outer: Callable[..., list[int]], tmp_path: Path, before: str) -> None:
    assert run_outer(10, 1, before) == [40, 0]
    assert not [*tmp_path.rglob("*.nbc"), *tmp_path.rglob("*.nbi")]


def test_a_change_in_another_file_is_noticed(run_outer: Callable[..., list[int]]) -> None:
    assert [run_outer(*way) for way in ((10, 1), (10, 1), (10, 2), (20, 2))] == [
        *([40, 0], [40, 1]),
        *([50, 0], [100, 0]),
    ]


def test_one_module_names_numbas_compiler_and_all_kernels_run_beside_python() -> None:
    """All other modules use its decorator, which works where no kernel can be cached."""
    folders = ("codec", "trainer", "server", "player", "bench", "fuzz")
    modules = [file for folder in folders for file in sorted((ROOT / folder).rglob("*.py"))]
    texts = {str(m.relative_to(ROOT)): m.read_text(encoding="utf-8") for m in modules}
    naming = [name for name, text in texts.items() if re.search(r"import n?jit|\bn?jit\(", text)]
    assert naming == ["codec/kernel.py"]
    codec = "".join(text for name, text in texts.items() if name.startswith("codec"))
    options = re.findall(r"@kernel\((.*)\)", codec)
    assert len(options) > 30
    assert all("nogil=True" in one for one in options)


def test_numba_is_not_loaded_before_a_kernel_is_run() -> None:
    """A failed import would be noticed by `output_of`."""
    names = "codec, server.__main__, player.config, trainer.__main__"
    assert output_of(f"import sys, {names}; print(int('numba' in sys.modules))") == [0]
