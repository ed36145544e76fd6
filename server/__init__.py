"""Streams over HTTP: a stream's files as they are, and plays whose layers the server chooses."""

from codec.version import __getattr__ as __getattr__
