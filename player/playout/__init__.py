"""When each frame is shown, and the threads that bring it there."""
