"""A Node process that answers questions: one JSON object per line in, one out."""

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
WEB = Path(__file__).parents[3] / "player" / "web"
SCRIPTS = WEB / "test" / "bridge"
"""Scripts that these tests run in Node, and in pages."""
PACKAGES = WEB / "node_modules"
NO_PACKAGES = "needs Node.js with npm: apt-get install npm, then scripts/setup dev"
ANSWER_S = 240.0
"""Time after which a browser counts as hanging. A repeated test has no other time limit."""


class NodeProcess:
    """Sends questions to a script, one after another. If the script has ended, the next question
    restarts it, so that a browser that hangs fails only one test."""

    def __init__(self, command: list[str]) -> None:
        self._command = command
        self._process = self._begun()

    def _begun(self) -> subprocess.Popen[str]:
        return subprocess.Popen(
            self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def answer(self, kind: str, question: dict[str, Any]) -> Json:
        """The whole answer of the script."""
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
    """Runs one of SCRIPTS."""
    assert NODE is not None
    with closing(NodeProcess([NODE, str(SCRIPTS / name), *args])) as process:
        yield process
