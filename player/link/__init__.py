"""A slow network link, as numbers and as a relay."""
