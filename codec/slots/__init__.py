"""Slots that last: a Gaussian as integers, and what a slice changes of them."""
