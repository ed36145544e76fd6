"""What a capture's cameras and pictures let one expect, before anything is trained."""
