"""Sliding-window training: who lives when, and what moves where."""
