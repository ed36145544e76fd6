"""Playing a stream: from a folder, a server or a static host to a window or to files."""
