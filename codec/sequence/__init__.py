"""Files of Gaussians, one for each frame, as a stream: what lasts is sent once."""
