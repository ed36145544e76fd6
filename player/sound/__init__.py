"""The sound of a stream: decoded, mixed for a listener, and played."""
