"""The first Gaussians: from points and from stereo."""
