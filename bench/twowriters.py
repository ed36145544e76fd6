"""Two of each writing command on one output, the second some seconds after the first: the first
one's result must be whole, and the second must end with 1 and one line.

Usage: scripts/bench twowriters [--times N] [--only KIND ...]

A second command that comes when the first has ended is no second writer: it is counted apart, and
only the result must be whole. Prints a table; exits with 1 if anything was lost.
"""

from __future__ import annotations

import shutil
import signal
import subprocess
import tempfile
import time
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from codec.console import run_command
from codec.errors import SwingsError
from codec.interop.formats import SplatFormat, write_splats
from codec.tools.audit import verify_stream
from tests.support.commands import command, environment, run_ok
from tests.support.sounding import write_wav
from tests.support.trained_like import trained_like_splats

KINDS = {
    "import": "stream import MODELS OUT --fps 15",
    "follow": "stream import MODELS OUT --fps 15 --follow --live.end-after-s 4",
    "follow --resume": "stream import MODELS OUT --fps 15 --follow --resume --live.end-after-s 4",
    "edit": "stream edit transform STREAM OUT --turn 10 20 30",
    "join": "stream edit join STREAM OUT --then STREAM",
    "audio": "stream audio add OUT SOUND.wav --name NAME",
    "captions": "stream captions add OUT LINES.vtt --language NAME",
    "pack": "stream pack STREAM OUT.swings",
    "unpack": "stream unpack PACKED.swings OUT",
    "export": "stream export STREAM OUT --static",
    "train": "train CAPTURE OUT --preset fast --frames 0:4 --segment-frames 1",
    "train --resume": "train CAPTURE OUT --resume",
}
"""Each writes OUT, or OUT.swings. NAME differs between the two."""

RESUMED = {"follow --resume": "follow", "train --resume": "train"}
"""The command that is begun and killed before."""

COPIED = ("audio", "captions")
"""The kinds that need a stream at OUT."""

DELAYS_S = (0, 1, 3)


@dataclass(frozen=True, slots=True)
class WritersConfig:
    """How often each pair of commands runs."""

    times: int = 5
    """Pairs of each kind and delay."""
    only: tuple[str, ...] = tuple(KINDS)
    """Kinds to try."""
    models: int = 60
    """Files of the sequence that is imported."""
    gs: int = 20_000
    """Gaussians of each file."""


def make_inputs(folder: Path, config: WritersConfig) -> None:
    (folder / "MODELS").mkdir()
    splats = trained_like_splats(config.gs)
    for number in range(config.models):
        splats.means[:] += np.float32(0.001)
        write_splats(folder / "MODELS" / f"{number:04d}.ply", splats, SplatFormat.PLY)
    run_ok("swings-stream", "import", "MODELS", "STREAM", "--fps", 15, folder=folder)
    run_ok("swings-stream", "pack", "STREAM", "PACKED.swings", folder=folder)
    run_ok(
        "swings-synth",
        "CAPTURE",
        "--frames",
        4,
        "--width-px",
        192,
        "--height-px",
        108,
        folder=folder,
    )
    write_wav(folder / "SOUND.wav", np.zeros((48_000 * 4, 2), np.int16))
    (folder / "LINES.vtt").write_text("WEBVTT\n\n00:00.000 --> 00:01.000\nHere\n")


def begun(words: str, name: str, folder: Path) -> subprocess.Popen[str]:
    program, *arguments = words.replace("NAME", name).split()
    return subprocess.Popen(
        command(f"swings-{program}", *arguments),
        cwd=folder,
        env=environment(),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def pair(kind: str, delay_s: float, folder: Path) -> str:
    """Runs two commands; gives what became of the second. Raises SwingsError if anything was
    lost."""
    for old in folder.glob("OUT*"):
        shutil.rmtree(old) if old.is_dir() else old.unlink()
    if kind in COPIED:
        shutil.copytree(folder / "STREAM", folder / "OUT")
    if kind in RESUMED:
        killed = begun(KINDS[RESUMED[kind]], "", folder)
        while not (folder / "OUT" / "segments" / "0").is_dir():
            time.sleep(0.05)
        killed.send_signal(signal.SIGKILL)
        killed.communicate()
    first = begun(KINDS[kind], "en", folder)
    time.sleep(delay_s)
    is_late = first.poll() is not None
    second = begun(KINDS[kind], "de", folder)
    ends = [(one.communicate()[1], one.returncode) for one in (first, second)]
    codes = sorted(code for _, code in ends)
    refused = [told for told, code in ends if code == 1 and "is being written by process" in told]
    output = folder / ("OUT.swings" if kind == "pack" else "OUT")
    verify_stream(output)
    if is_late:
        return "after the first"
    if codes == [0, 1] and len(refused) == 1 and len(refused[0].splitlines()) == 1:
        return "refused"
    if codes == [0, 1] and any("is not empty" in told for told, _ in ends):
        return "after the first"
    if codes == [0, 0] and kind not in ("import", "follow", "edit", "join", "unpack", "export"):
        return "both, one after the other"
    raise SwingsError(f"{kind}, {delay_s} s apart: {codes}, {[told for told, _ in ends]}")


def main(config: WritersConfig) -> None:
    table = Table("", *(f"{delay_s} s" for delay_s in DELAYS_S), box=box.SIMPLE)
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        make_inputs(folder, config)
        for kind in config.only:
            cells = []
            for delay_s in DELAYS_S:
                found = Counter(pair(kind, delay_s, folder) for _ in range(config.times))
                cells.append(", ".join(f"{count} {what}" for what, count in found.items()))
            table.add_row(kind, *cells)
            Console(stderr=True).print(kind, *cells, sep="  ")
    Console().print(table)


if __name__ == "__main__":
    run_command(WritersConfig, main, "twowriters", __doc__ or "")
