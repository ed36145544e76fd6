"""What swings-stream does with a whole stream: check it, draw it, export it."""
