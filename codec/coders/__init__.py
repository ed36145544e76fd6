"""Entropy coders: what a chunk's bytes become on disk and on the wire."""
