"""Made-up streams, as numbers only."""

from __future__ import annotations

from hypothesis import strategies as st

from server.abr.media import SegmentSizes
from tests.support.delivery.media import MadeMedia, sizes_of


@st.composite
def segment_sizes(draw: st.DrawFn, num_layers: int) -> SegmentSizes:
    """An upper layer takes at least a third of the first one, and adds 0.3 to 3 dB, so that sending
    a layer that the link cannot carry is never worth a stall."""
    base = draw(st.floats(2e3, 2e4))
    layers = (base, *(base * draw(st.floats(0.35, 1.5)) for _ in range(num_layers - 1)))
    gains = (25.0, *(draw(st.floats(0.3, 3.0)) for _ in range(num_layers - 1)))
    snapshots = tuple(size * draw(st.floats(2.0, 8.0)) for size in layers)
    return sizes_of(layers, gains, snapshots)


@st.composite
def medias(draw: st.DrawFn, fewest_frames: int = 20, most_frames: int = 150) -> MadeMedia:
    """Streams of one or two kinds of segments."""
    num_layers = draw(st.integers(1, 4))
    count = draw(st.integers(1, 2))
    return MadeMedia(
        tuple(draw(segment_sizes(num_layers)) for _ in range(count)),
        draw(st.integers(fewest_frames, most_frames)),
        draw(st.sampled_from((25.0, 30.0))),
        draw(st.sampled_from((4, 15, 30, 40))),
    )
