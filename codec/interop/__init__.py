"""Streams made of other programs' files of Gaussians, and frames as files for them."""
