"""A process of Node that answers: one JSON object a line in, one out."""

from __future__ import annotations

import json
import shutil
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

Json = Any

NODE = shutil.which("node")
SCRIPTS = Path(__file__).parents[2] / "player" / "web"
ANSWER_S = 240.0
"""A browser that has not answered for so long never will. A test that runs again has no other
limit."""


class NodeProcess:
    """Questions, one after another."""

    def __init__(self, process: subprocess.Popen[str], name: str) -> None:
        self._process = process
        self._name = name

    def answer(self, kind: str, question: dict[str, Any]) -> Json:
        """All that it says."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps({"ask": kind, **question}) + "\n")
        self._process.stdin.flush()
        limit = threading.Timer(ANSWER_S, self._process.kill)
        limit.start()
        line = self._process.stdout.readline()
        limit.cancel()
        limit.join()
        assert line, f"{self._name} ended, or did not answer {kind} in {ANSWER_S:g} s"
        return json.loads(line)


@contextmanager
def running_script(name: str, *args: str) -> Iterator[NodeProcess]:
    """The script of that name beside the tests of player/web."""
    assert NODE is not None
    command = [NODE, str(SCRIPTS / name), *args]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        yield NodeProcess(process, name)
