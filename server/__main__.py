"""swings-serve: streams over HTTP."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated

import tyro

from codec.console import run_command

from .library import Library
from .listener import RunningServer, bind, run_until_stopped, url_of
from .state.config import ServerConfig
from .state.serverstate import ServerState


@dataclass(frozen=True, slots=True)
class ServeCommand:
    """Serve one stream, or a folder of streams."""

    root: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="ROOT")]]
    """Folder of a stream, or of streams; or their URL in an object store, as s3://BUCKET/PATH."""
    host: str = "127.0.0.1"
    """Address to listen on; 0.0.0.0 for all of IPv4."""
    port: int = 8080
    """TCP port; 0 for any free one."""
    server: tyro.conf.OmitArgPrefixes[ServerConfig] = field(default_factory=ServerConfig)


def run(command: ServeCommand) -> None:
    library = Library(command.root, command.server.refresh_s)
    listener = bind(command.host, command.port)

    def ready() -> None:
        print(f"serving {url_of(listener)}", flush=True)
        for name in sorted(library.streams):
            print(name, flush=True)

    asyncio.run(_serve(command, library, listener, ready))


async def _serve(
    command: ServeCommand, library: Library, listener: socket.socket, ready: Callable[[], None]
) -> None:
    server = RunningServer(ServerState(library, command.server), listener)
    await run_until_stopped(server, ready)


def main() -> None:
    run_command(ServeCommand, run, "swings-serve", "Serves streams over HTTP.")


if __name__ == "__main__":
    main()
