"""The streams that are served: found, followed while they grow, and dropped when they go."""

from .library import Library
from .servedstream import ServedStream

__all__ = ["Library", "ServedStream"]
