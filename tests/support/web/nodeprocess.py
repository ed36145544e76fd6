"""A process of Node that answers: one JSON object a line in, one out."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

Json = Any

NODE = shutil.which("node")
SCRIPTS = Path(__file__).parents[2] / "player" / "web"


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
        line = self._process.stdout.readline()
        assert line, f"{self._name} ended; its stderr says why"
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
