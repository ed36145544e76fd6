"""Policies: what a client is sent next. Each is one file.."""
