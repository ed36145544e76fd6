"""A run from a capture folder to a stream: settings, outputs, checkpoints, log."""
