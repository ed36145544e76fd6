"""From a capture to a stream: readers, a synthetic capture, the sliding-window trainer, scores."""

from codec.version import __getattr__ as __getattr__
