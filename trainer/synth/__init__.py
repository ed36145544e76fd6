"""A procedural capture with ground truth: a figure walking and waving in a room."""
