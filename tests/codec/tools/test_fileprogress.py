"""How far an import is, where a terminal is and where none is."""

from __future__ import annotations

import os
import pty
import re
import subprocess
from pathlib import Path

import pytest

from codec.interop.formats import SplatFormat, write_splats
from codec.tools.fileprogress import told
from tests.support.commands import command, environment
from tests.support.trained_like import trained_like_splats


def test_where_no_terminal_is_a_line_comes_now_and_then(
    capsys: pytest.CaptureFixture[str],
) -> None:
    now_s = 100.0
    with told("importing x", lambda: now_s) as tell:
        for done in range(1, 41):
            now_s += 1
            tell(done, 40)
    lines = capsys.readouterr().err.splitlines()
    assert lines == [
        "importing x: 25 %, 30 s left",
        "importing x: 50 %, 20 s left",
        "importing x: 75 %, 10 s left",
        "importing x: 100 %",
    ]


def test_a_long_time_is_told_in_minutes(capsys: pytest.CaptureFixture[str]) -> None:
    now_s = 100.0
    with told("importing x", lambda: now_s) as tell:
        tell(0, 40)
        now_s += 30
        tell(1, 40)
    assert capsys.readouterr().err == "importing x: 2 %, 20 min left\n"


def test_a_terminal_has_a_bar_and_80_columns_hold_it(tmp_path: Path) -> None:
    folder = tmp_path / "a-folder-of-splats"
    folder.mkdir()
    for number in range(3):
        write_splats(folder / f"{number}.ply", trained_like_splats(50), SplatFormat.PLY)
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        command("swings-stream", "import", folder, tmp_path / "s", "--fps", 30),
        env=environment() | {"COLUMNS": "80", "TERM": "xterm"},
        stdout=subprocess.DEVNULL,
        stderr=theirs,
    )
    os.close(theirs)
    seen = b""
    try:
        while data := os.read(ours, 1 << 16):
            seen += data
    except OSError:  # what Linux says when the other end is closed
        pass
    os.close(ours)
    assert process.wait(timeout=60) == 0
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", seen.decode())
    assert "importing a-folder-of-splats" in plain
    assert "100 %" in plain
    assert max(map(len, re.split(r"[\r\n]+", plain))) <= 80
