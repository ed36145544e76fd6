"""Sound and captions of a finished stream: files, what is added to a stream, and the commands."""
