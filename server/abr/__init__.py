"""Adaptive bitrate, pure: nothing here does I/O or reads a clock."""
