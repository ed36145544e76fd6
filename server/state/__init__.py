"""What all requests to one running server share: streams, memory, plays, settings, figures."""
