"""Progress of a training run: one line in a terminal, or plain lines at intervals."""

from __future__ import annotations

import os
import pty
import re
import select
import subprocess
from pathlib import Path

from codec.progressline import line_of
from tests.support.commands import command, environment
from tests.support.tiny_capture import write_dynerf
from trainer.run.runstatus import RunStatus

TINY = (
    "--num-gs", 100, "--genesis-iterations", 40, "--settle-rounds", 1, "--window-iterations", 20,
)  # fmt: skip


def test_a_usual_line_fits_80_columns_with_all_that_is_known() -> None:
    long = RunStatus(1149, 3000, 0.383, 45_296, 72_960, 28.412, 33_123, 106.5).stage()
    assert line_of(long, 80) == (
        "frame 1149 of 3000  38% done  12:34:56 elapsed, 20:16:00 left  28.41 dB"
    )
    usual = RunStatus(149, 150, 0.383, 754, 1234, 28.412, 33_123, 106.5).stage()
    assert line_of(usual, 80) == (
        "frame 149 of 150  38% done  12:34 elapsed, 20:34 left  28.41 dB  33.1 kB/frame"
    )


def test_a_run_whose_output_is_a_file_says_how_it_goes(tmp_path: Path) -> None:
    write_dynerf(tmp_path / "capture", 4, 2)
    done = subprocess.run(
        command("swings-train", tmp_path / "capture", tmp_path / "stream", *TINY),
        env=environment(),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    lines = [line for line in done.stderr.splitlines() if " done" in line]
    assert lines[0].startswith("first of 2 frames")
    assert lines[-1].startswith("frame 1 of 2  100% done")
    assert lines[-1].endswith("it/s")
    assert " dB  " in lines[-1]
    assert all(len(line) <= 80 and line.isprintable() for line in lines)


def test_on_a_terminal_of_80_columns_it_is_one_line(tmp_path: Path) -> None:
    write_dynerf(tmp_path / "capture", 4, 2)
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        command("swings-train", tmp_path / "capture", tmp_path / "stream", *TINY),
        env={**environment(), "COLUMNS": "80", "TERM": "xterm", "NO_COLOR": "1"},
        stdout=subprocess.DEVNULL,
        stderr=theirs,
    )
    os.close(theirs)
    shown = b""
    while select.select([ours], [], [], 120)[0]:
        try:
            block = os.read(ours, 1 << 16)
        except OSError:  # Linux: there is no writer any more
            break
        shown += block
        if not block:
            break
    os.close(ours)
    assert process.wait(timeout=60) == 0
    drawn = [part for part in re.split("[\r\n]+", shown.decode()) if " done" in part]
    for part in drawn:
        line = re.sub(r"\x1b\[[?0-9]*[a-zA-Z]", "", part)
        assert line.isprintable()
        assert len(line.rstrip()) < 80
    assert " dB  " in drawn[-1]
    # Drawn in place: the old text is erased, and one line stays.
    assert all("\x1b[2K" in part for part in drawn[1:])
