"""A server with workers that names the worker which answers and then echoes, run as a module with
WHAT CONFIG: its URL is on the first line of stdout, its log on stderr.

WHAT: "echo", where "hang" is echoed and blocks the event loop; "slow", which ends when its clients
have gone; "stubborn", which never ends; "refuse", which cannot start.

A file "refuse" in the folder prevents further workers from starting.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import sys
import threading
from functools import partial

from codec.errors import SwingsError
from server.operate.log.eventlog import EventLog, take_over_logging
from server.operate.log.logline import LogStyle
from server.operate.workers.arbiter import WorkerHooks, run_workers
from server.operate.workers.supervisorconfig import SupervisorConfig
from server.operate.workers.workerprocess import StreamWorker
from tests.support.server.virtualtime import passes


async def serve(what: str, worker: StreamWorker) -> None:
    if what == "refuse" or os.path.exists("refuse"):  # noqa: ASYNC240 - the server has not begun
        raise SwingsError("there is nothing\nto serve")
    loop = asyncio.get_running_loop()
    stop = asyncio.Event()
    loop.add_signal_handler(signal.SIGTERM, stop.set)
    talks = set[asyncio.Task[None] | None]()

    async def talk(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        talks.add(asyncio.current_task())
        try:
            writer.write(f"{worker.number} {os.getpid()}\n".encode())
            while line := await reader.readline():
                writer.write(line)
                await writer.drain()
                if line == b"hang\n":
                    threading.Event().wait()
        except (ConnectionError, asyncio.CancelledError):
            pass
        finally:
            writer.close()

    server = await asyncio.start_server(talk, sock=worker.listener, backlog=512)
    worker.ready()
    await stop.wait()
    if what == "stubborn":
        await asyncio.Event().wait()
    # When its server closes, asyncio drops accepted connections that it does not serve yet.
    loop.remove_reader(worker.listener)
    await passes(0)
    server.close()
    if what == "slow":
        await asyncio.gather(*filter(None, talks))


def main() -> None:
    what, settings = sys.argv[1], json.loads(sys.argv[2])
    listener = socket.create_server(("127.0.0.1", 0), backlog=512)
    port = listener.getsockname()[1]
    log = EventLog(2, LogStyle.JSON)
    take_over_logging(log)

    def forget(number: int) -> None:
        log.event("forgotten", worker=number)

    def ready() -> None:
        sys.stdout.write(f"serving http://127.0.0.1:{port}\n")
        sys.stdout.flush()

    try:
        hooks = WorkerHooks(serve=partial(serve, what), log=log, ready=ready, forget=forget)
        run_workers(listener, SupervisorConfig(**settings), hooks)
    except SwingsError as error:
        sys.exit(f"failed: {error}")


if __name__ == "__main__":
    main()
