"""What swings-serve may be told; its workers read it again from the environment."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar, Final

import tyro

from codec.errors import InvalidError
from codec.helptext import Groups

from .state.config import ServerConfig

PREFIX: Final = "SWINGS_SERVE"
"""Of the variables: --max-plays is SWINGS_SERVE_MAX_PLAYS."""

SAMPLE: Final = Path(__file__).with_name("sample") / "walk.swings"
"""Two seconds of a synthetic scene in less than a megabyte: something to see before a training."""


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
    """Print the settings that would be used as lines of an environment file, read keys and
    certificate, and exit. Every option can also be set by an environment variable: --max-plays by
    SWINGS_SERVE_MAX_PLAYS."""
    end_with_stdin: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """End when standard input is closed, so that the server does not outlive the process that
    started it."""
    server: tyro.conf.OmitArgPrefixes[ServerConfig] = field(default_factory=ServerConfig)
    """Limits, access, log and cache of the server."""

    @property
    def place(self) -> str:
        """The folder, file or URL to serve."""
        return str(SAMPLE) if self.sample else self.root

    def check(self) -> None:
        """Raises InvalidError if it does not say what to serve."""
        if bool(self.root) == self.sample:
            raise InvalidError("give the ROOT of your streams, or --sample to see one")
