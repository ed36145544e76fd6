"""An X server without a screen."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

XVFB = shutil.which("Xvfb")


@contextmanager
def x_server() -> Iterator[str]:
    """Runs an X server; gives the name of its display."""
    if XVFB is None:
        pytest.skip("needs Xvfb, an X server without a screen")
    reading, writing = os.pipe()
    # It goes on when its last window has closed.
    command = [XVFB, "-displayfd", str(writing), "-screen", "0", "640x480x24", "-noreset"]
    command += ["-nolisten", "tcp"]
    process = subprocess.Popen(command, pass_fds=(writing,), stderr=subprocess.DEVNULL)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        number = pipe.readline().strip()
    try:
        yield f":{number}"
    finally:
        process.terminate()
        process.wait()
