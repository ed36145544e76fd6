"""The same number of layers whatever happens: what `?layers=N` asks for."""

from __future__ import annotations

from codec.errors import InvalidError

from .decisioncontext import DecisionContext, Send, SendSlices, SendSnapshots
from .media import segment_start


class FixedLayers:
    """Sends slices in order, each complete at once. Fewer layers only where the server allows no
    more; they come back at a segment's first frame, behind its slice."""

    mends = False

    def __init__(self, num_layers: int) -> None:
        """num_layers: as many as there are if it is more."""
        if num_layers < 1:
            raise InvalidError(f"layers is {num_layers}; give at least 1")
        self._num_layers = num_layers

    def choose(self, context: DecisionContext) -> Send | None:
        media, holding = context.media, context.holding
        wanted = min(self._num_layers, context.num_layers)
        birth = holding.end_birth(0)
        if birth is None:
            first = segment_start(media, context.clock.first_frame)
            return SendSnapshots(first, 0, wanted) if first < context.end_birth else None
        held = next((n for n in range(wanted) if holding.end_birth(n) != birth), wanted)
        if held < wanted and (birth - 1) % media.segment_frames == 0:
            return SendSnapshots(birth - 1, held, wanted)
        if birth >= context.end_birth:
            return None
        size = media.sizes(birth).slice_bytes[held - 1]
        end = min(context.end_birth, birth + context.run_length(size, context.rate_bps))
        if held < wanted:
            # With the slice of a segment's first frame they stop: snapshots follow.
            first = segment_start(media, birth + media.segment_frames - 1)
            end = min(end, first + 1)
        return SendSlices(range(birth, end), 0, held)
