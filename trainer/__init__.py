"""From a capture to a stream: readers, a synthetic capture, the sliding-window trainer, scores."""
