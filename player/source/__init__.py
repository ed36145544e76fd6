"""Where slices come from: a folder, a server, or any static host."""
