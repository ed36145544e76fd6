"""Bytes that the kernel sends by itself, and that nobody can alter any more."""

from __future__ import annotations

import os
import sys
from typing import Final

if sys.platform == "linux":
    import fcntl

SUPPORTED: Final = hasattr(os, "memfd_create") and hasattr(os, "sendfile")
"""Whether this system has such files; without them bodies are sent from ordinary memory."""


class MemoryFile:
    """An unnamed file in memory, sealed; closed when nobody holds it."""

    __slots__ = ("descriptor", "size")

    def __init__(self, data: bytes | memoryview) -> None:
        """Copies `data`. Raises OSError when there are no descriptors or no memory left."""
        self.size = len(data)
        self.descriptor = os.memfd_create("swings", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
        rest = memoryview(data)
        while rest:
            rest = rest[os.write(self.descriptor, rest) :]
        seals = fcntl.F_SEAL_WRITE | fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW | fcntl.F_SEAL_SEAL
        fcntl.fcntl(self.descriptor, fcntl.F_ADD_SEALS, seals)

    def read(self, start: int, stop: int) -> bytes:
        """Bytes start..stop-1."""
        return os.pread(self.descriptor, stop - start, start)

    def __del__(self) -> None:
        descriptor = getattr(self, "descriptor", -1)
        if descriptor >= 0:
            os.close(descriptor)
