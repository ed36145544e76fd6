"""Whole streams edited without training: crop, transform, colour, floaters, trim, join."""
