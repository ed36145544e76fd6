"""gunicorn's settings for several workers, what these share and what they serve with.
`swings-serve --workers N` becomes

    gunicorn --config python:server.gunicornconf server.gunicornconf:create

with its own settings in variables, SWINGS_SERVE_ROOT=/srv/swings and so on. GUNICORN_CMD_ARGS adds
gunicorn's. This module is read once, before gunicorn forks; its workers inherit it.
"""

from __future__ import annotations

import logging
import math
import os
import secrets
import signal
import traceback
from types import FrameType
from typing import Any

import tyro
from aiohttp import web
from gunicorn.arbiter import Arbiter
from gunicorn.workers.base import Worker

from codec.errors import SwingsError
from server.operate.workers import SHARED_MEMORY, WorkerFolder

from .listener import BACKLOG, bound_connections
from .operate.log import STDERR, EventLog, LineFormatter, take_over_logging
from .operate.prometheus import forget_worker
from .operate.settings import settings_parser
from .operate.watchdog import Watchdog
from .servecommand import PREFIX, ServeCommand
from .serving import RunningServer, end_with_stdin, make_state

log = logging.getLogger(__name__)

command: ServeCommand = settings_parser(PREFIX)(
    ServeCommand, args=(), prog="swings-serve", config=(tyro.conf.EnumChoicesFromValues,)
)
command.check()
serving = command.server

folder = WorkerFolder()
"""Where the workers keep what each may read of the others."""
play_secret = secrets.token_bytes(32)
"""Authenticates the tokens of plays, also those of earlier workers."""
watchdog = Watchdog()
"""Before gunicorn tells systemd that it is ready: that is for a worker to say."""
number = 0
"""Of the worker that is forked next, or is this process."""
_numbers: dict[Worker, int] = {}

bind = (
    f"[{command.host}]:{command.port}" if ":" in command.host else f"{command.host}:{command.port}"
)
backlog = BACKLOG
workers = serving.supervisor.workers
worker_class = "aiohttp.GunicornWebWorker"
timeout = serving.supervisor.worker_timeout_s
graceful_timeout = math.ceil(serving.supervisor.shutdown_timeout_s)
certfile = str(serving.tls_cert) if serving.tls_cert else None
keyfile = str(serving.tls_key) if serving.tls_key else None
worker_tmp_dir = SHARED_MEMORY  # of the heartbeats, which a disk could delay
control_socket_disable = True
logconfig_dict: dict[str, Any] = {
    "disable_existing_loggers": False,
    "formatters": {"line": {"()": LineFormatter, "style": serving.log}},
    "handlers": {"stderr": {"class": "logging.StreamHandler", "formatter": "line"}},
    "root": {"level": "INFO", "handlers": ["stderr"]},
    "loggers": {"gunicorn.error": {"level": "INFO", "propagate": True}},
}

HANG_FRAMES = 5
"""Innermost frames of a hanging event loop that are logged."""


def when_ready(server: Arbiter) -> None:
    """The sockets are there; no worker is yet."""
    for listener in server.LISTENERS:
        bound_connections(listener.sock, serving.timeouts.write_timeout_s)


def pre_fork(server: Arbiter, worker: Worker) -> None:
    """Numbers the worker, so that no two living ones have the same."""
    global number
    taken = set(_numbers.values())
    number = _numbers[worker] = next(n for n in range(len(taken) + 1) if n not in taken)
    folder.make()  # somebody may have cleared it


def child_exit(server: Arbiter, worker: Worker) -> None:
    """Its gauges, such as its connections, are over."""
    ended = _numbers.pop(worker)
    forget_worker(folder.path, ended)
    fields = {"worker": ended, "pid": worker.pid}
    log.info("a worker ended", extra={"event": "worker_ended", "fields": fields})


def post_worker_init(worker: Worker) -> None:
    """A worker that hangs says where. aiohttp's own handler of SIGABRT waits for the event loop."""
    signal.signal(signal.SIGABRT, _say_where)


def _say_where(number: int, frame: FrameType | None) -> None:
    stack = traceback.extract_stack(frame)[: -HANG_FRAMES - 1 : -1]
    log.critical("the event loop hangs in %s", ", ".join(f"{f.filename}:{f.lineno}" for f in stack))
    raise SystemExit(1)


def on_exit(server: Arbiter) -> None:
    folder.remove()


async def create() -> web.AppRunner:
    """The runner of one worker. What cannot be served ends the server with one line."""
    events = EventLog(STDERR, serving.log)
    events.__enter__()  # logging closes it at the end of the process
    take_over_logging(events)
    try:
        state = make_state(command.place, serving, events, number, folder.path, play_secret)
        runner = RunningServer(state, events)
    except (SwingsError, OSError) as error:
        # It ends the server; a second one on the way would end gunicorn with a traceback.
        if not folder.is_first("failed"):
            raise SystemExit(0) from None
        log.critical("%s", error)
        raise SystemExit(Arbiter.APP_LOAD_ERROR) from None

    async def ready(_: web.Application) -> None:
        events.event("worker_ready", worker=number, pid=os.getpid())
        watchdog.ready()

    runner.app.on_startup.append(ready)
    if command.end_with_stdin:
        end_with_stdin(os.getppid())
    return runner
