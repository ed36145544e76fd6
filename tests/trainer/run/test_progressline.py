"""What a person sees of a run: one line of a terminal, or plain lines at intervals."""

from __future__ import annotations

import io
import os
import pty
import re
import select
import subprocess
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from tests.support.commands import command, environment
from tests.support.tiny_capture import write_dynerf
from trainer.run.progressline import TELL_EVERY_S, ProgressLine, Standing, clock, line_of

TINY = (
    "--num-gs", 100, "--genesis-iterations", 40, "--settle-rounds", 1, "--window-iterations", 20,
)  # fmt: skip

finite = st.floats(0, 1e7)
standings = st.builds(
    Standing,
    frame=st.integers(0, 10**7),
    num_frames=st.integers(1, 10**7),
    share=st.floats(0, 1),
    gone_s=finite,
    left_s=st.none() | finite,
    psnr_db=st.none() | st.floats(-10, 100),
    bytes_per_frame=st.none() | finite,
    iterations_per_s=st.none() | finite,
)


@given(standings, st.integers(1, 200))
def test_the_line_fits_and_leaves_out_whole_parts_only(told: Standing, columns: int) -> None:
    line = line_of(told, columns)
    assert 0 < len(line) <= columns
    whole = line_of(told, 10_000)
    assert whole.startswith(line)
    if len(line) < columns and line != whole:
        assert whole[len(line) :].startswith("  ")


def test_a_usual_line_fits_80_columns_with_all_that_is_known() -> None:
    told = Standing(1149, 3000, 0.383, 45_296, 72_960, 28.412, 33_123, 106.5)
    assert (
        line_of(told, 80)
        == (
            "frame 1149 of 3000  38% done  12:34:56 elapsed, 20:16:00 left  28.41 dB  33.1 kB/frame"
        )[:80].rsplit("  ", 1)[0]
    )
    usual = Standing(149, 150, 0.383, 754, 1234, 28.412, 33_123, 106.5)
    assert line_of(usual, 80) == (
        "frame 149 of 150  38% done  12:34 elapsed, 20:34 left  28.41 dB  33.1 kB/frame"
    )


@pytest.mark.parametrize(
    ("time_s", "text"), [(0, "0:00"), (59.6, "1:00"), (245, "4:05"), (3845, "1:04:05")]
)
def test_times_are_read_at_a_glance(time_s: float, text: str) -> None:
    assert clock(time_s) == text


def test_without_a_terminal_a_line_comes_at_intervals_and_at_the_end() -> None:
    now_s = [0.0]
    file = io.StringIO()
    with ProgressLine(Console(file=file, width=20), lambda: now_s[0]) as line:
        for second in range(round(2.5 * TELL_EVERY_S)):
            now_s[0] = second
            line.tell(Standing(0, 5, second / 100, second, 100 - second))
            lines = file.getvalue().splitlines()
            assert len(lines) == 1 + second // TELL_EVERY_S
        assert lines[1] == "first of 5 frames  30% done  0:30 elapsed, 1:10 left"
    assert file.getvalue().splitlines()[-1].startswith("first of 5 frames  74% done")
    assert len(file.getvalue().splitlines()) == 4


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
        except OSError:  # Linux: nobody writes any more
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
    # Drawn in place: what was there is wiped out, and one line stays.
    assert all("\x1b[2K" in part for part in drawn[1:])
