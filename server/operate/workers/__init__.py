"""Several worker processes on one listening socket: how they start and end, and how they talk."""
