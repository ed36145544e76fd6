"""The installed commands as real processes."""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from tests.support.forked.commands import command_server
from tests.support.waiting import BOUND_S

ROOT = Path(__file__).parents[2]
"""The root of the repository."""
ENTRY = {
    "swings-synth": "trainer.__main__:synth",
    "swings-train": "trainer.__main__:train",
    "swings-eval": "trainer.__main__:evaluate",
    "swings-stream": "player.streamcommand:main",
    "swings-serve": "server.__main__:main",
    "swings-play": "player.__main__:main",
    "swings-abr": "server.study.__main__:main",
    "swings-capture": "trainer.__main__:capture",
    "swings-sign": "server.operate.sign.__main__:main",
}


def command(name: str, *arguments: object) -> list[str]:
    """The command line of console script, or entry point, `name`; it need not be installed."""
    module, function = ENTRY.get(name, name).split(":")
    code = f"import sys; from {module} import {function} as main; sys.exit(main())"
    return [sys.executable, "-c", code, *map(str, arguments)]


PROGRESS = re.compile(r"^.*  \d+(:\d\d)+ elapsed.*\n", re.MULTILINE)
"""Lines of `counted`, which a command writes only where its work takes ten seconds."""


def unhurried(text: str) -> str:
    """The standard error `text` of a command as on a quick machine: without `PROGRESS`."""
    return PROGRESS.sub("", text)


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "160"}


def run(
    name: str,
    *arguments: object,
    timeout_s: float | None = None,
    folder: Path | None = None,
    limits: dict[str, int] | None = None,
) -> subprocess.CompletedProcess[str]:
    """Runs the command as a process of its own, forked from one that has imported all commands. Its
    working directory is `folder`, or the test's. limits: see Request. pytest ends a hang. Standard
    error is `unhurried`, but for swings-train, which always writes its progress."""
    variables = environment()
    server = command_server(os.getpid())
    argv, words = command(name, *arguments), [*map(str, arguments)]
    if server.suits(variables):
        entry = ENTRY.get(name, name)
        done = server.run(entry, argv, words, variables, timeout_s, folder, limits)
    else:
        assert not limits
        done = subprocess.run(
            argv, cwd=folder, env=variables, capture_output=True, text=True, timeout=timeout_s
        )
    if name != "swings-train":
        done.stderr = unhurried(done.stderr)
    return done


def run_ok(name: str, *arguments: object, folder: Path | None = None) -> str:
    """Runs the command; returns its standard output. Fails the test unless it exits with 0."""
    done = run(name, *arguments, folder=folder)
    assert done.returncode == 0, f"{name} {arguments}: {done.stderr[-2000:]}"
    return done.stdout


def started(
    name: str, *arguments: object, stdout: int = subprocess.DEVNULL
) -> subprocess.Popen[str]:
    """Starts the command as a process; its standard error is a pipe."""
    return subprocess.Popen(
        command(name, *arguments),
        env=environment(),
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
    )


IDLE = ("--shed-from", "2", "--refuse-from", "3")
"""Options of a server to which a busy machine is no load of its own: it refuses nobody."""


@contextlib.contextmanager
def serving(
    root: Path | str, *arguments: object, program: Sequence[str] | None = None
) -> Iterator[str]:
    """Runs a server process for `root`, a folder or a URL; gives its URL and terminates it at the
    end. program: the command line to run instead of swings-serve."""
    words = map(str, arguments)
    process = subprocess.Popen(
        [*(program or command("swings-serve")), str(root), "--port", "0", *IDLE, *words],
        env=environment() if program is None else None,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert process.stdout is not None
    try:
        ready = process.stdout.readline()
        assert ready.startswith("serving "), ready
        yield ready.split()[1]
    finally:
        process.terminate()
        process.wait(timeout=BOUND_S)
        process.stdout.close()
