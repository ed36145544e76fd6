"""One training step: render, compare, differentiate, on the CPU or a GPU."""
