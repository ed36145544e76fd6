"""A stream directory, from both ends."""

from .reader import StreamReader
from .writer import StreamWriter

__all__ = ["StreamReader", "StreamWriter"]
