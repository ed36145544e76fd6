"""The stream in a browser while it is trained: swings-serve as a process beside the run."""

from __future__ import annotations

import math
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

from codec.errors import InvalidError, SwingsError
from codec.splats import Splats
from codec.storage.openstorage import Target, open_growing
from codec.stream.manifest import MANIFEST_NAME, Manifest
from codec.stream.poster import put_poster
from codec.stream.writer import SHAPE
from player.render.cpu import render_splats
from trainer.fit.observer import Observer, Progress

SERVE_LOG_NAME = "serve.log"
"""The server's log, in the work folder."""

PREVIEW_S = 3.0
"""From one picture of the scene to the next, before the stream has frames."""

CLOSE_S = 5.0
"""Time for the server to end by itself."""

_SERVED_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,79}", re.ASCII)


def watch_name(target: Target) -> str:
    """The name of the stream at `target` in the server's URLs. Raises InvalidError if it has
    none."""
    path = target.absolute() if isinstance(target, Path) else target
    name = str(path).rstrip("/").rpartition("/")[2]
    if not _SERVED_NAME.fullmatch(name):
        raise InvalidError(
            f"--serve: {name!a} cannot be part of a URL; name the stream's folder with letters, "
            "digits, '.', '_' and '-'"
        )
    return name


class Preview(Observer):
    """Draws the scene as the stream's poster, which the page of a stream without frames shows:
    from the first Gaussians on until the first segment is written."""

    def __init__(
        self,
        target: Target,
        manifest: Manifest,
        shown: Callable[[int], Splats],
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """shown: the Gaussians of a frame as they are now."""
        self._target, self._manifest, self._shown, self._now_s = target, manifest, shown, now_s
        self._last_s = -math.inf

    def window_begun(self, first_frame: int, done: int) -> None:
        self._draw_if_due(first_frame)

    def progressed(self, progress: Progress) -> None:
        self._draw_if_due(progress.first_frame)

    def _draw_if_due(self, frame: int) -> None:
        is_due = self._now_s() - self._last_s >= PREVIEW_S
        if frame < self._manifest.segment_frames and is_due:
            put_poster(self._target, self._manifest, self._shown(frame), render_splats)
            self._last_s = self._now_s()


class LiveView(Observer, AbstractContextManager["LiveView"]):
    """Serves a stream from the moment that it has a manifest until the block ends.

    The server is a process of its own, so that no viewer slows the training by holding the
    interpreter, and it ends with this process, however that ends.
    """

    def __init__(self, target: Target, port: int, work: Path, say: Callable[[str], None]) -> None:
        """port: 0 for any free one. work: folder of the server's log. say: prints a line.

        Raises InvalidError if the stream's name cannot be served.
        """
        self._target, self._port, self._work, self._say = target, port, work, say
        self._name = watch_name(target)
        self._process: subprocess.Popen[str] | None = None

    def window_begun(self, first_frame: int, done: int) -> None:
        """Starts the server once. Raises SwingsError if it cannot start."""
        if self._process is None and MANIFEST_NAME in open_growing(self._target, SHAPE).names():
            self._start()

    def _start(self) -> None:
        # -P: the current folder may hold another `server`.
        command = [sys.executable, "-P", "-m", "server", str(self._target)]
        command += ["--port", str(self._port), "--end-with-stdin"]
        places = [place or os.getcwd() for place in sys.path]
        log_path = self._work / SERVE_LOG_NAME
        with open(log_path, "ab") as log:
            self._process = process = subprocess.Popen(
                command,
                env={**os.environ, "PYTHONPATH": os.pathsep.join(places)},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                start_new_session=True,  # Ctrl-C is for the training; the pipe ends the server
            )
        assert process.stdout is not None
        ready = process.stdout.readline()
        if not ready.startswith("serving "):
            process.wait()
            lines = log_path.read_text(errors="replace").strip().splitlines()
            reason = lines[-1] if lines else f"exit code {process.returncode}"
            raise SwingsError(f"--serve: the server does not start: {reason}")
        self._say(f"watch it at {ready.split()[1]}/watch/{self._name}")

    def __exit__(self, *_: object) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        with process:
            try:
                process.communicate(timeout=CLOSE_S)
            except subprocess.TimeoutExpired:
                process.kill()
