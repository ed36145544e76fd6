"""Settings of the worker processes."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass

from codec.errors import InvalidError

MAX_WORKERS = 256

MIN_WORKER_TIMEOUT_S = 2
"""Below it a heartbeat that is a little late would end a worker."""


@dataclass(frozen=True, slots=True)
class SupervisorConfig:
    """Number, shutdown and heartbeat of the worker processes."""

    workers: int = 1
    """Number of worker processes; use one for each core that is to serve."""
    shutdown_timeout_s: float = 10.0
    """Seconds that workers have to shut down before they are killed."""
    worker_timeout_s: int = 15
    """With two or more workers: seconds without a heartbeat of its event loop after which a worker
    is killed and replaced."""

    def __post_init__(self) -> None:
        if not 1 <= self.workers <= MAX_WORKERS:
            raise InvalidError(f"workers is {self.workers}; give 1 to {MAX_WORKERS}")
        if self.workers > 1 and sys.platform == "win32":
            raise InvalidError(f"workers is {self.workers}; Windows allows only 1; give 1")
        if not 0 < self.shutdown_timeout_s < math.inf:
            raise InvalidError(
                f"shutdown_timeout_s is {self.shutdown_timeout_s}; it must be positive"
            )
        if self.worker_timeout_s < MIN_WORKER_TIMEOUT_S:
            raise InvalidError(
                f"worker_timeout_s is {self.worker_timeout_s}; give {MIN_WORKER_TIMEOUT_S} or more"
            )
