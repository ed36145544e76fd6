"""Whole streams edited without training: crop, transform, floaters, view, trim, join."""
