"""The handlers of the server's URLs."""
