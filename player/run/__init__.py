"""The work of swings-play: playing a stream, and drawing a single frame."""
