"""Properties of a capture's cameras and pictures that tell how well it will train."""
