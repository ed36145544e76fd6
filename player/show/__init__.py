"""Where pictures go: a window or files."""
