"""Plays in virtual time."""
