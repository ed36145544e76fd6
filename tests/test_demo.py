"""`scripts/demo` from its first line to its last, on a scene that takes seconds.

The script runs unchanged, in a folder where `.venv/bin` has the real commands with smaller settings
appended to those of the script.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import subprocess
import time
import urllib.error
import urllib.request
from pathlib import Path

import pytest

from tests.support.commands import ROOT, command, environment

SMALLER = {
    "swings-synth": "--frames 6 --cameras 5 --width-px 32 --height-px 32 --points 50",
    "swings-train": "--num-gs 60 --genesis-iterations 4 --settle-rounds 1 --window-iterations 1",
    "swings-serve": "",
    "swings-play": "--renderer cpu --size 64x36",
    "swings-eval": "",
}


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    bin_folder, scripts = tmp_path / ".venv" / "bin", tmp_path / "scripts"
    bin_folder.mkdir(parents=True)
    scripts.mkdir()
    shutil.copy(ROOT / "scripts" / "demo", scripts)
    (scripts / "setup").write_text("#!/bin/sh\n")
    for name, options in SMALLER.items():
        words = shlex.join(command(name))
        (bin_folder / name).write_text(f'#!/bin/sh\nexec {words} "$@" {options}\n')
    (bin_folder / "python").write_text(
        f'#!/bin/sh\nexec {shlex.quote(command("swings-eval")[0])} "$@"\n'
    )
    for program in [scripts / "setup", *bin_folder.iterdir()]:
        program.chmod(0o755)
    return tmp_path


@pytest.mark.slow
def test_without_serving_it_ends_and_leaves_everything(checkout: Path) -> None:
    done = subprocess.run(
        ["sh", "scripts/demo", "--no-serve"],
        cwd=checkout,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert done.returncode == 0, done.stderr
    assert "held-out PSNR" in done.stdout
    assert "/watch/" not in done.stdout
    for name in ("play.mp4", "play.png", "sheet.png", "stream/index.bin", "capture"):
        assert (checkout / "demo" / name).stat().st_size > 0


def is_served(link: str) -> bool:
    try:
        with urllib.request.urlopen(link, timeout=5):
            return True
    except OSError:
        return False


def test_it_serves_the_stream_until_ctrl_c(checkout: Path) -> None:
    process = subprocess.Popen(
        ["sh", "scripts/demo"],
        cwd=checkout,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    )
    assert process.stdout is not None
    try:
        links = (re.search(r"http://\S+/watch/stream", line) for line in process.stdout)
        link = next(found[0] for found in links if found)
        with urllib.request.urlopen(link, timeout=20) as answer:
            assert answer.status == 200
        os.killpg(process.pid, signal.SIGINT)
        assert process.wait(timeout=30) == 0
        until_s = time.monotonic() + 20
        while is_served(link):  # the server takes a moment to close its connections
            assert time.monotonic() < until_s
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait(timeout=20)
        process.stdout.close()


def test_other_words_are_refused(checkout: Path) -> None:
    done = subprocess.run(
        ["sh", "scripts/demo", "--serve"], cwd=checkout, capture_output=True, text=True
    )
    assert done.returncode == 2
    assert done.stderr == "usage: scripts/demo [--no-serve]\n"
    assert not (checkout / "demo").exists()
