"""An import keeps two frames and a segment in memory, for any length of the sequence."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from codec.interop.formats import SplatFormat, write_splats
from tests.support.commands import ROOT
from tests.support.slots.rotating import figure, turned

CODE = """
import re, sys
from pathlib import Path
from codec.sequence.importing import ImportOptions, import_stream
import_stream(Path(sys.argv[1]), Path(sys.argv[2]), ImportOptions(fps=30))
# Not of `resource`, which counts what the parent had when it forked.
print(re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())[1])
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="memory is read from /proc")
def test_memory_does_not_grow_with_the_frames(tmp_path: Path) -> None:
    splats = figure(8000)
    folder = tmp_path / "seq"
    folder.mkdir()
    files = []
    for number in range(4):
        files.append(folder / f"f{number:04d}.ply")
        write_splats(files[-1], turned(splats, 0.01 * number), SplatFormat.PLY)

    def most_kb(out: str) -> int:
        done = subprocess.run(
            [sys.executable, "-c", CODE, folder, tmp_path / out],
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            capture_output=True,
            text=True,
            check=True,
            timeout=240,
        )
        return int(done.stdout)

    most_kb("warm")  # compiles what is not compiled yet
    for number in range(4, 20):
        os.link(files[number % 4], folder / f"f{number:04d}.ply")
    short = most_kb("short")
    for number in range(20, 100):
        os.link(files[number % 4], folder / f"f{number:04d}.ply")
    long = most_kb("long")
    assert sum(file.stat().st_size for file in folder.iterdir()) > 40 << 20
    assert long - short < 6 << 10
