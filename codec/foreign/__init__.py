"""Files of Gaussians as other programs write them: bytes to a Splats and back."""
