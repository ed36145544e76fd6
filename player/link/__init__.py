"""A slow network link: as the user writes it, and as a relay."""
