"""What gunicorn's workers serve with; gunicornconf says how it is started."""

from __future__ import annotations

import logging
import os

from aiohttp import web
from gunicorn.arbiter import Arbiter

from codec.errors import SwingsError
from server.serving import create_runner, end_with_stdin, make_state

from .operate.log import STDERR, EventLog, take_over_logging

log = logging.getLogger(__name__)


async def create() -> web.AppRunner:
    """The runner of one worker. What cannot be served ends the server with one line."""
    from . import gunicornconf as shared  # read before this process was forked

    events = EventLog(STDERR, shared.serving.log)
    events.__enter__()  # logging closes it at the end of the process
    take_over_logging(events)
    try:
        state = make_state(
            shared.command.place,
            shared.serving,
            events,
            shared.number,
            shared.folder.path,
            shared.play_secret,
        )
        runner = create_runner(state, events)
    except (SwingsError, OSError) as error:
        # It ends the server; a second one on the way would end gunicorn with a traceback.
        if not shared.folder.is_first("failed"):
            raise SystemExit(0) from None
        log.critical("%s", error)
        raise SystemExit(Arbiter.APP_LOAD_ERROR) from None

    async def ready(_: web.Application) -> None:
        events.event("worker_ready", worker=shared.number, pid=os.getpid())
        shared.watchdog.ready()

    runner.app.on_startup.append(ready)
    if shared.command.end_with_stdin:
        end_with_stdin(os.getppid())
    return runner
