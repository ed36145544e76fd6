"""Time from the last byte of a file to its picture, with `swings-stream import --follow`.

A process writes files in place, at a fixed rate; the installed commands follow and serve them; a
player draws them over HTTP.

Usage: scripts/bench follow [--gaussians N] [--fps F] [--seconds S] [--sh-degree D]
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from bench.serve.processes import serving
from codec.console import run_command
from codec.errors import InvalidError, SwingsError
from codec.framerange import FrameRange
from codec.interop.formats import SplatFormat, encode_splats
from player.playout.clock import Clock
from player.playout.conductor import Conductor
from player.playout.queues import Events
from player.playout.timeline import Playout
from player.render.gl import create_renderer
from player.render.renderer import RendererKind
from player.run.playback import WINDOW_PLAYOUT
from player.source.opener import Opener
from player.source.source import Source
from player.view.path import Size, camera_path
from tests.support.commands import command, environment
from tests.support.deforming import Deforming

SIZE = Size(640, 360)
PATIENCE_S = 60.0
PIECES = 4
"""Number of writes per file."""
WRITTEN_NAME = "written.json"


@dataclass(frozen=True, slots=True)
class FollowConfig:
    """Follows a sequence that is written at a fixed rate, and measures when its frames show."""

    gaussians: int = 10_000
    """Gaussians of a frame."""
    fps: float = 10.0
    """Files a second."""
    seconds: float = 30.0
    """Length of the sequence."""
    sh_degree: int = 3
    """Degree of the spherical harmonics."""
    join_s: float = 10.0
    """Seconds after the first picture at which the viewer seeks to the live edge, like a viewer who
    joins later; pictures count from then on."""
    write: Path | None = None
    """Only write the files to this folder. The command starts itself with this option."""

    def __post_init__(self) -> None:
        if self.gaussians < 1 or not self.fps > 0 or not self.seconds > self.join_s > 0:
            raise InvalidError("choose 1 Gaussian or more, and more seconds than before the join")

    @property
    def num_frames(self) -> int:
        return round(self.seconds * self.fps)


def write(config: FollowConfig, folder: Path) -> None:
    """Writes the files in place, each at its time, and a file of the times of their last bytes."""
    deforming = Deforming(config.gaussians, config.sh_degree)
    # Encoded in advance, so that the writer uses little of the CPU.
    files = [encode_splats(deforming.next(), SplatFormat.PLY) for _ in range(config.num_frames)]
    written_s: list[float] = []
    begin_s = time.time() + 0.5
    for number, data in enumerate(files):
        time.sleep(max(0.0, begin_s + number / config.fps - time.time()))
        with open(folder / f"frame_{number:05d}.ply", "wb", buffering=0) as file:
            for piece in range(PIECES):
                file.write(data[len(data) * piece // PIECES : len(data) * (piece + 1) // PIECES])
        written_s.append(time.time())
    (folder / WRITTEN_NAME).write_text(json.dumps(written_s))


@contextmanager
def following(folder: Path, stream: Path, fps: float, said: list[str]) -> Iterator[None]:
    """Runs the command during the block and ends it with Ctrl-C; adds its output to `said`."""
    words = command("swings-stream", "import", folder, stream, "--follow", "--fps", f"{fps:g}")
    with open(stream.parent.parent / "said", "w+", encoding="utf-8") as printed:
        process = subprocess.Popen(words, env=environment(), stdout=printed)
        try:
            yield
        finally:
            process.send_signal(signal.SIGINT)
            if process.wait(timeout=60):
                raise SwingsError(f"swings-stream ended with {process.returncode}")
        printed.seek(0)
        said += printed.read().splitlines()


def watch(url: str, config: FollowConfig, shown_s: dict[int, float]) -> None:
    """Plays from the live edge, like a window after End; fills in when each frame was drawn."""
    num_frames = config.num_frames
    clock = Clock(real=True)
    with closing(Opener(url)) as opener:

        def open_at(frame: int) -> Source:
            return opener.open(FrameRange(frame), None, adaptive=True)

        def events(source: Source, play: int, not_before_s: float) -> Events:
            frames = source.frames
            playout = Playout(
                source.manifest,
                frames.first,
                frames.end,
                config=WINDOW_PLAYOUT,
                not_before_s=not_before_s,
                play=play,
            )
            return Events(playout, clock)

        with Conductor(open_at, events, clock, interrupt=opener.interrupt) as conductor:
            manifest = conductor.source.manifest
            path = camera_path("default", manifest, SIZE, conductor.source.frames)
            with closing(create_renderer(RendererKind.CPU, manifest)) as renderer:
                conductor.attach(renderer)
                began_s, is_at_edge = time.monotonic(), False
                until_s = began_s + PATIENCE_S + num_frames / manifest.fps
                while time.monotonic() < until_s:
                    records = conductor.poll()
                    if not records:
                        time.sleep(0.002)
                        continue
                    frame = records[-1].frame
                    renderer.render_again(frame, path(frame))
                    shown_s.setdefault(frame, time.time())
                    if not is_at_edge and time.monotonic() > began_s + config.join_s:
                        conductor.seek_newest()
                        is_at_edge = True
                        shown_s.clear()
                    if frame >= num_frames - 1 - manifest.segment_frames:
                        return
    raise SwingsError("the last frame did not show")


def until_there(path: Path) -> None:
    until_s = time.monotonic() + PATIENCE_S
    while not path.exists():
        if time.monotonic() > until_s:
            raise SwingsError(f"{path} did not come within {PATIENCE_S:.0f} s")
        time.sleep(0.02)


def run(config: FollowConfig) -> None:
    if config.write is not None:
        write(config, config.write)
        return
    with tempfile.TemporaryDirectory() as made:
        folder, stream = Path(made) / "files", Path(made) / "streams" / "live"
        folder.mkdir()
        stream.parent.mkdir()
        shown_s: dict[int, float] = {}
        said: list[str] = []
        asked = [f"--gaussians={config.gaussians}", f"--fps={config.fps}"]
        asked += [f"--seconds={config.seconds}", f"--join-s={config.join_s}"]
        asked += [f"--sh-degree={config.sh_degree}"]
        with following(folder, stream, config.fps, said):
            program = [sys.executable, __file__, *asked, "--write", str(folder)]
            writer = subprocess.Popen(program)
            until_there(stream / "segments" / "0")
            with serving(stream, "--log", "json", log=Path(made) / "log") as (_, port):
                watch(f"http://127.0.0.1:{port}", config, shown_s)
            if writer.wait(timeout=PATIENCE_S):
                raise SwingsError(f"the writer ended with {writer.returncode}")
        written_s = json.loads((folder / WRITTEN_NAME).read_text())
    delays_s = np.array([shown_s[frame] - written_s[frame] for frame in sorted(shown_s)])
    table = Table("Gaussians", "degree", "fps", "frames shown", "p50", "p90", "max")
    cells = (f"{s:.2f} s" for s in np.percentile(delays_s, (50, 90, 100)))
    sizes = (f"{config.gaussians}", f"{config.sh_degree}", f"{config.fps:g}", f"{len(delays_s)}")
    table.add_row(*sizes, *cells)
    console = Console(width=110)
    console.print(table)
    console.print("from the last byte of a file to its picture, drawn by a player over HTTP")
    console.print(*said, sep="\n", markup=False)


if __name__ == "__main__":
    run_command(FollowConfig, run, "scripts/bench follow", "Measures how live --follow is.")
