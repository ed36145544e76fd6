"""Signed URLs: each gives access to one stream, until it expires."""
