"""What swings-stream does with a whole stream: sum it up, check it, draw it, export it."""
