"""Signed URLs: who has one may see one stream, until a certain time."""
