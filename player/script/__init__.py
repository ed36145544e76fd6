"""Streams in Python: a scene that gives any frame, by itself or in viser."""
