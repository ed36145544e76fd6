"""The server's log: one line a request or event, whatever clients send."""
