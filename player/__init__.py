"""Playing a stream: sources, the playout clock, the ring of slices, the renderers."""
