"""`scripts/demo` from its first line to its last.

The script runs unchanged, in a folder whose `.venv/bin` has the real commands with smaller settings
appended to those of the script. In the gate a capture and a stream that are there already stand for
filming and training.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

from tests.support.commands import ENTRY, ROOT, command, environment, run
from tests.support.tiny_capture import seen_by, write_dynerf
from tests.support.tiny_stream import tiny_manifest, write_tiny
from tests.support.waiting import BOUND_S, wait_until

SMALLER = {
    "swings-synth": "--frames 6 --cameras 5 --width-px 32 --height-px 32 --points 50",
    "swings-train": "--num-gs 60 --genesis-iterations 4 --settle-rounds 1 --window-iterations 1",
    "swings-play": "--renderer cpu --size 64x36",
}
MADE = ("play.mp4", "play.png", "sheet.png", "stream/index.bin", "capture")


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    (tmp_path / ".venv" / "bin").mkdir(parents=True)
    (tmp_path / "scripts").mkdir()
    shutil.copy(ROOT / "scripts" / "demo", tmp_path / "scripts")
    write_program(tmp_path / "scripts" / "setup", "")
    write_program(tmp_path / ".venv" / "bin" / "python", f'exec {sys.executable} "$@"')
    for name in ENTRY:
        line = f'exec {shlex.join(command(name))} "$@" {SMALLER.get(name, "")}'
        write_program(tmp_path / ".venv" / "bin" / name, line)
    return tmp_path


def write_program(path: Path, line: str) -> None:
    path.write_text(f"#!/bin/sh\n{line}\n")
    path.chmod(0o755)


def started(checkout: Path, *words: str) -> subprocess.Popen[str]:
    """Starts the script as the leader of a group of processes."""
    return subprocess.Popen(
        ["sh", "scripts/demo", *words],
        cwd=checkout,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    )


def is_served(link: str) -> bool:
    try:
        with urllib.request.urlopen(link, timeout=BOUND_S) as answer:
            return bool(answer.status == 200)
    except OSError:
        return False


def test_it_scores_and_serves_the_stream_until_ctrl_c(checkout: Path) -> None:
    capture, stream, asked = checkout / "filmed", checkout / "trained", checkout / "asked"
    write_dynerf(capture, 3, 4)
    write_tiny(stream, 4, seen_by(tiny_manifest(), capture))
    bin_folder = checkout / ".venv" / "bin"
    write_program(bin_folder / "swings-synth", f'echo "$0 $*" > {asked}; cp -r {capture} "$1"')
    write_program(bin_folder / "swings-train", f'echo "$0 $*" >> {asked}; cp -r {stream} "$2"')
    with started(checkout) as process:
        try:
            assert process.stdout is not None
            links = (re.search(r"http://\S+/watch/stream", line) for line in process.stdout)
            link = next(found[0] for found in links if found)
            assert is_served(link)
            os.killpg(process.pid, signal.SIGINT)
            assert process.wait(timeout=BOUND_S) == 0
            wait_until(lambda: not is_served(link))  # its connections close a moment later
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
    assert all((checkout / "demo" / name).exists() for name in MADE)
    for line in asked.read_text().splitlines():
        program, *words = shlex.split(line)
        done = run(Path(program).name, *words, folder=checkout)
        assert done.returncode == 1, done.stderr  # wrong options would be a 2
        assert "not empty" in done.stderr


@pytest.mark.deep
def test_without_serving_it_ends_and_leaves_everything(checkout: Path) -> None:
    with started(checkout, "--no-serve") as process:
        said, _ = process.communicate()
    assert process.returncode == 0
    assert "held-out PSNR" in said
    assert "/watch/" not in said
    assert all((checkout / "demo" / name).stat().st_size > 0 for name in MADE)


def test_other_words_are_refused(checkout: Path) -> None:
    words = ["sh", "scripts/demo", "--serve"]
    done = subprocess.run(words, cwd=checkout, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr == "usage: scripts/demo [--no-serve]\n"
    assert not (checkout / "demo").exists()
