"""A process that has imported the commands, and forks a command for each request.

`python -m tests.support.forked.commandserver MODULE:FUNCTION` first calls that function, which
loads what the commands need. A line on its standard input is a request as JSON (`Request`). The
answer is the pid of the command, which no other process has until the next line, an empty one, asks
for its end; the answer to that is its exit status. A fork takes milliseconds, a new interpreter a
second.
"""

from __future__ import annotations

import atexit
import importlib
import json
import os
import re
import resource
import sys
import threading
import traceback
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

PRELOADED = (
    "numba",
    "trainer.run.job",
    "trainer.score.evaluatecommand",
    "trainer.synth.film",
    "codec.sequence.importing",
    "player.run.playback",
    "player.streamcommand",
    "server.serving",
    "server.study.__main__",
)
"""Modules that the commands import, at once or when they run."""


@dataclass(frozen=True, slots=True)
class Request:
    """A command to run."""

    entry: str
    """module:function"""
    argv: list[str]
    """The command line of the interpreter, with the command's arguments at its end."""
    arguments: list[str]
    environment: dict[str, str]
    folder: str
    out: str
    """File for the standard output."""
    err: str
    limits: dict[str, int]
    """Bytes of FSIZE, the longest file, and of DATA, the memory on top of the server's."""

    def to_line(self) -> str:
        return json.dumps(asdict(self)) + "\n"


def set_limits(limits: dict[str, int]) -> None:
    """Limits this process. Linux only."""
    # Python 3.11 keeps half a .pyc if there is no room for the other half.
    sys.dont_write_bytecode = bool(limits)
    for name, limit in limits.items():
        if name == "DATA":
            found = re.search(r"VmData:\s+(\d+) kB", Path("/proc/self/status").read_text())
            assert found
            limit += 1024 * int(found[1])
        kind = getattr(resource, f"RLIMIT_{name}")
        resource.setrlimit(kind, (limit, limit))


def exit_status(code: object) -> int:
    """Exit status that an interpreter gives for the code of a SystemExit."""
    if code is None:
        return 0
    if isinstance(code, int):
        return code & 255
    sys.stderr.write(f"{code}\n")
    return 1


def run(request: Request) -> int:
    """Runs the command in this process; returns its exit status."""
    for number, path in enumerate((os.devnull, request.out, request.err)):
        opened = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
        os.dup2(opened, number)
        os.close(opened)
    set_limits(request.limits)
    os.environ.clear()
    os.environ.update(request.environment)
    os.chdir(request.folder)
    sys.orig_argv, sys.argv = request.argv, ["-c", *request.arguments]
    try:
        code = function_of(request.entry)()
    except SystemExit as ended:
        code = ended.code
    except BaseException:
        traceback.print_exc()
        code = 1
    status = exit_status(code)
    threading._shutdown()  # type: ignore[attr-defined]  # like an interpreter at its end
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    return status


def function_of(entry: str) -> Callable[[], object]:
    module, _, function = entry.partition(":")
    found: Callable[[], object] = getattr(importlib.import_module(module), function)
    return found


def preload() -> None:
    """Imports the commands, and loads the kernels that read a stream. Those that draw start
    threads, which no fork has."""
    for name in PRELOADED:
        importlib.import_module(name)
    from codec.stream import StreamReader
    from player.rehearsal import STREAM

    StreamReader(STREAM).active_splats(1, 1)


def main() -> None:
    function_of(sys.argv[1])()
    for line in iter(sys.stdin.readline, ""):
        request = Request(**json.loads(line))
        pid = os.fork()
        if not pid:
            status = 1
            try:
                status = run(request)
            finally:
                os._exit(status)
        sys.stdout.write(f"{pid}\n")
        sys.stdout.flush()
        sys.stdin.readline()
        status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        sys.stdout.write(f"{status}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
