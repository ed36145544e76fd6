"""Slices of Gaussians to bytes and back: the vocabulary and the stream format of swings."""
