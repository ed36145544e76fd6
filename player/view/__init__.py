"""Where the camera is: paths, key frames, and the mouse."""
