"""swings-serve: streams over HTTP."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import tyro

from codec.console import run_command
from codec.errors import InvalidError
from codec.helptext import Groups

from .listener import bind, url_of
from .operate.settings import settings_parser
from .serving import SAMPLE, Service, end_with_stdin
from .state.config import ServerConfig


@dataclass(frozen=True, slots=True)
class ServeCommand:
    """Serve one stream, or a folder of streams."""

    EVERYDAY: ClassVar[Groups] = {
        "Address": ("host", "port", "tls-cert", "tls-key"),
        "Access": ("keys", "public", "cors-origin", "trusted-proxies"),
        "Load": ("workers", "max-plays", "max-address-plays"),
        "Log and settings": ("log", "log-requests", "check-config", "sample"),
    }

    root: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="ROOT")]] = ""
    """Folder of one stream, its .swings file, or a folder of several of them; or the URL of one of
    these in an object store: s3://BUCKET/PATH."""
    sample: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Serve the sample that swings brings along, in place of ROOT, and print where to watch it."""
    host: str = "127.0.0.1"
    """Address to listen on; 0.0.0.0 for all IPv4 addresses, :: for all IPv4 and IPv6 addresses."""
    port: int = 8080
    """TCP port; 0 for any free port."""
    check_config: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print the settings that would be used as lines of an environment file, and exit. Every option
    can also be set by an environment variable: --max-plays by SWINGS_SERVE_MAX_PLAYS."""
    end_with_stdin: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """End when standard input is closed, so that the server does not outlive the process that
    started it."""
    server: tyro.conf.OmitArgPrefixes[ServerConfig] = field(default_factory=ServerConfig)
    """Limits, access, log and cache of the server."""


def run(command: ServeCommand) -> None:
    if bool(command.root) == command.sample:
        raise InvalidError("give the ROOT of your streams, or --sample to see one")
    root = str(SAMPLE) if command.sample else command.root
    listener = bind(command.host, command.port)
    url = url_of(listener, "http" if command.server.tls_cert is None else "https")
    service = Service(root, command.server, listener)
    if command.end_with_stdin:
        end_with_stdin()
    more = f"\nwatch it in a browser: {url}/watch/{SAMPLE.stem}" if command.sample else ""
    if command.server.keys is not None:
        more = f"\nopens with links of: swings-sign {command.server.keys} STREAM --url {url}"
    service.run(ready=lambda: print(f"serving {url}{more}", flush=True))


def main() -> None:
    run_command(
        ServeCommand,
        run,
        "swings-serve",
        "Serves streams over HTTP.",
        settings_parser("SWINGS_SERVE"),
    )


if __name__ == "__main__":
    main()
