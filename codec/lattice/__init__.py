"""Gaussians as integers: steps, equal forms, curves through space, and floats as they are."""
