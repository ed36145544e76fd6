"""Streams in Python: a scene that gives any frame."""
