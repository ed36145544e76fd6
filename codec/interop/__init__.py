"""Files of Gaussians for other programs and from them, of any format."""
