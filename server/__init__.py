"""Streams over HTTP: a stream's files as they are, and plays whose layers the server chooses."""
