"""Several worker processes on one listening socket: who starts them, and how they talk."""
