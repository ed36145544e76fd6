"""Slots that last (format version 2): a Gaussian as integers, and what a slice changes of them."""
