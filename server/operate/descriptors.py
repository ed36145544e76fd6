"""How many connections the limit of open files allows."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from codec.errors import SwingsError

if sys.platform != "win32":
    import resource

RESERVE = 64
"""Descriptors kept for what is not a connection: files of objects, the log, the event loop."""

WINDOWS_SOCKETS = 512
"""The most sockets that `select`, and so an event loop, watches on Windows."""

RAISE_TO = 65_536
"""The soft limit is raised to the hard one, but not above this: an unlimited table costs memory."""


def connection_limit(wanted: int) -> int:
    """The most connections, `wanted` or fewer, that this process has descriptors for.

    Raises the process's own soft limit as far as the hard one allows. Raises SwingsError where
    there is not room for one.
    """
    if sys.platform == "win32":
        return min(wanted, WINDOWS_SOCKETS - RESERVE)
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    ceiling = RAISE_TO if hard == resource.RLIM_INFINITY else min(hard, RAISE_TO)
    if soft != resource.RLIM_INFINITY and soft < ceiling:
        resource.setrlimit(resource.RLIMIT_NOFILE, (ceiling, hard))
        soft = ceiling
    if soft == resource.RLIM_INFINITY:
        return wanted
    taken = open_descriptors() + RESERVE
    if soft <= taken:
        raise SwingsError(
            f"the limit of open files is {soft}, which leaves none for connections; "
            f"raise it (ulimit -n) to {taken + wanted}"
        )
    return min(wanted, soft - taken)


def open_descriptors() -> int:
    """How many this process has open."""
    for folder in ("/proc/self/fd", "/dev/fd"):
        if Path(folder).is_dir():
            return len(os.listdir(folder)) - 1  # listing it takes one
    return 3
