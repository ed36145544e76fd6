"""Client of the process of commandserver.py, for tests."""

from __future__ import annotations

import atexit
import contextlib
import os
import select
import signal
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path

from tests.support.forked.commandserver import Request
from tests.support.waiting import BOUND_S

ROOT = Path(__file__).parents[3]

PRELOAD = "tests.support.forked.commandserver:preload"
READ_AT_IMPORT = ("PYTHON", "NUMBA", "OMP", "OPENBLAS", "MPL", "LD_")
"""Prefixes of variables that libraries read when they are imported, so that a fork has the values
of its server."""


class CommandServer:
    """The process; it forks one command at a time. preload: a function that it calls first."""

    def __init__(self, environment: dict[str, str], preload: str = PRELOAD) -> None:
        self._fixed = _fixed(environment)
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.support.forked.commandserver", preload],
            cwd=ROOT,
            env={**environment, "PYTHONPATH": str(ROOT)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,  # select does not see a line that Python has read ahead
        )
        atexit.register(self.close)

    def suits(self, environment: dict[str, str]) -> bool:
        """Whether a fork behaves like a new process with `environment`."""
        return _fixed(environment) == self._fixed and self._process.poll() is None

    def run(
        self,
        entry: str,
        argv: list[str],
        arguments: list[str],
        environment: dict[str, str],
        timeout_s: float | None,
        folder: Path | None = None,
        limits: dict[str, int] | None = None,
    ) -> subprocess.CompletedProcess[str]:
        """Like subprocess.run with text output. After `timeout_s` it kills the command and raises
        TimeoutExpired. limits: see Request; the output of a command with limits fits in a pipe."""
        with tempfile.TemporaryDirectory() as made, contextlib.ExitStack() as stack:
            out, err = Path(made) / "out", Path(made) / "err"
            for path in (out, err) if limits else ():
                os.mkfifo(path)  # a limit of files is not one of the output
            flags = os.O_RDWR | os.O_CREAT | os.O_NONBLOCK
            outputs = [
                stack.enter_context(open(os.open(path, flags, 0o600), "rb", buffering=0))
                for path in (out, err)
            ]
            where = str(folder or os.getcwd())
            words = (where, str(out), str(err), limits or {})
            pid = None
            try:
                pid = self.start(Request(entry, argv, arguments, environment, *words), timeout_s)
                status = self.ended(timeout_s)
                said = [(file.read() or b"").decode() for file in outputs]
                return subprocess.CompletedProcess(argv, status, *said)
            except BaseException:
                # A test's time limit can end it anywhere; its answers are not for the next command.
                if pid is not None:
                    os.kill(pid, signal.SIGKILL)
                self.close()
                command_server.cache_clear()
                raise

    def start(self, request: Request, timeout_s: float | None = BOUND_S) -> int:
        """Starts the command; returns its pid, which no other process has until it has `ended`."""
        return self._answer(request.to_line(), timeout_s)

    def ended(self, timeout_s: float | None = BOUND_S) -> int:
        """Waits for the end of the command that was started; returns its exit status."""
        return self._answer("\n", timeout_s)

    def _answer(self, line: str, timeout_s: float | None) -> int:
        """The number that the server prints next. Raises TimeoutExpired."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(line.encode())
        if not select.select([self._process.stdout], [], [], timeout_s)[0]:
            raise subprocess.TimeoutExpired(line, timeout_s or 0.0)
        return int(self._process.stdout.readline())

    def close(self) -> None:
        atexit.unregister(self.close)
        self._process.kill()
        self._process.communicate()


def _fixed(environment: dict[str, str]) -> dict[str, str]:
    fixed = {key: value for key, value in environment.items() if key.startswith(READ_AT_IMPORT)}
    fixed.pop("PYTHONPATH", None)
    return fixed


@cache
def command_server(pid: int) -> CommandServer:
    """The server of this process, whose id is `pid`."""
    return CommandServer(dict(os.environ))
