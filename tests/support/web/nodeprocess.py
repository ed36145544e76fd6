"""A process of Node that answers: one JSON object a line in, one out."""

from __future__ import annotations

import json
import shutil
import subprocess
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

Json = Any

NODE = shutil.which("node")
SCRIPTS = Path(__file__).parents[2] / "player" / "web"
ANSWER_S = 240.0
"""A browser that has not answered for so long never will. A test that runs again has no other
limit."""


class NodeProcess:
    """Questions, one after another, to a script. One that has ended begins anew with the next
    question: a browser that hangs fails one test, not those behind it as well."""

    def __init__(self, command: list[str]) -> None:
        self._command = command
        self._process = self._begun()

    def _begun(self) -> subprocess.Popen[str]:
        return subprocess.Popen(
            self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def answer(self, kind: str, question: dict[str, Any]) -> Json:
        """All that it says."""
        if self._process.poll() is not None:
            self.close()
            self._process = self._begun()
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps({"ask": kind, **question}) + "\n")
        self._process.stdin.flush()
        limit = threading.Timer(ANSWER_S, self._process.kill)
        limit.start()
        line = self._process.stdout.readline()
        limit.cancel()
        limit.join()
        if not line:
            self._process.wait()
            raise AssertionError(
                f"{self._command[1]} ended, or did not answer {kind} in {ANSWER_S:g} s"
            )
        return json.loads(line)

    def close(self) -> None:
        """Waits for the process to end."""
        with suppress(BrokenPipeError), self._process:
            pass


@contextmanager
def running_script(name: str, *args: str) -> Iterator[NodeProcess]:
    """The script of that name beside the tests of player/web."""
    assert NODE is not None
    with closing(NodeProcess([NODE, str(SCRIPTS / name), *args])) as process:
        yield process
