"""Rendering recipe v1 and its back ends: one picture everywhere."""
