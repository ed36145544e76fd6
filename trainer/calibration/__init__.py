"""Calibrations of other programs, as captures."""
