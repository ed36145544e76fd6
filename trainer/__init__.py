"""From a capture to a stream: readers, the sliding-window trainer, evaluation."""
