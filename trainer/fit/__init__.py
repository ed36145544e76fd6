"""Sliding-window training: which Gaussians live when, and how they move."""
