"""Operation of the server: load, limits, addresses, metrics, settings."""
