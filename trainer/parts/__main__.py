"""A worker of a run in parts: `python -m trainer.parts TASK.json`, a line for each bit of progress.

Not for people: `swings-train --ray` starts it. It ends when its standard input does, so that it
does not outlive who started it.
"""

from __future__ import annotations

import os
import sys
import threading
from pathlib import Path

# Threads that wait must not spin; see trainer/__main__.py.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

from rich.console import Console

from codec.errors import SwingsError
from codec.storage.openfiles import open_files
from trainer.run.warm import start_over_if_compiled

from .task import Task
from .taskprocess import FAILED
from .worker import opened_worker


def main() -> int:
    """Reads the task, does it."""
    task = Task.from_json(Path(sys.argv[1]).read_text(encoding="utf-8"))
    threading.Thread(target=_end_with_stdin, daemon=True).start()
    if open_files(task.run.config.target).holds(task.last_path):
        return 0  # whoever did it died before it could say so
    start_over_if_compiled(task.run.config.fit.sh_degree, Console(file=sys.stderr, quiet=True))
    try:
        with opened_worker(task, lambda iterations: print(iterations, flush=True)) as worker:
            worker.work()
    except SwingsError as error:
        print(error, file=sys.stderr)
        return FAILED
    return 0


def _end_with_stdin() -> None:
    sys.stdin.read()
    os._exit(1)


if __name__ == "__main__":
    sys.exit(main())
