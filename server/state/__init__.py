"""State shared by all requests to a running server: streams, caches, plays, settings, metrics."""
