"""The process of `--link`: reads what to do as one line of JSON, tells where it listens, and then
answers each line with its counters, until its input ends."""

from __future__ import annotations

import asyncio
import json
import socket
import sys
import threading
from typing import Any

from server.abr.link import Link, LinkStep

from .relay import SEND_BUFFER_BYTES, Relay


def write_line(**values: object) -> None:
    print(json.dumps(values), flush=True)


async def run(order: dict[str, Any]) -> None:
    link = Link([LinkStep(*step) for step in order["steps"]])
    relay = Relay(link, order["host"], order["port"])
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.setblocking(False)
        # Inherited by accepted connections.
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        serving = asyncio.create_task(relay.serve(listener))
        write_line(port=listener.getsockname()[1])
        loop = asyncio.get_running_loop()

        def answer() -> None:
            for _ in sys.stdin:
                write_line(down_bytes=relay.down_bytes, began_s=relay.began_s)
            loop.call_soon_threadsafe(serving.cancel)  # whoever started this has gone

        threading.Thread(target=answer, daemon=True).start()
        await asyncio.wait([serving])
        if not serving.cancelled():
            serving.result()


def main() -> None:
    try:
        asyncio.run(run(json.loads(sys.stdin.readline())))
    except OSError as error:
        write_line(error=str(error))
        sys.exit(1)


if __name__ == "__main__":
    main()
