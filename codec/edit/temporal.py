"""The temporal layer of a stream is added, removed, or gets another period. With all layers every
frame stays as it is."""

from __future__ import annotations

from codec.stream.manifest import Manifest

from .edit import Edit


class TemporalLayer(Edit):
    """All frames but every `period`-th are in a temporal layer; 1: there is none."""

    def __init__(self, period: int) -> None:
        self._period = period

    def manifest(self, source: Manifest) -> Manifest:
        return source.with_temporal_layer(self._period)
