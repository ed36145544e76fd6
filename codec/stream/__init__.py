"""A stream's folder, from both ends: what writes it and what reads it."""

from .reader import StreamReader
from .writer import StreamWriter

__all__ = ["StreamReader", "StreamWriter"]
