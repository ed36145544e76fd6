"""The order of arrival of objects and packets does not matter: the final state of a player equals
that of a plain reader that gets the same data in order of birth."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from tests.goldens.decoder import Shape
from tests.support.slots.arrivals import make_arrivals, played
from tests.support.slots.plain import make_shape


@given(
    st.builds(
        make_shape,
        swin_size=st.sampled_from([1, 2, 3]),
        segment_frames=st.sampled_from([3, 5, 9, 14]),
        k=st.sampled_from([1, 4]),
        slots=st.sampled_from([(9,), (6, 5), (1, 4, 3)]),
    ),
    st.integers(0, 1 << 32),
)
@settings(max_examples=25)
def test_any_order_ends_in_the_same_slots(shape: Shape, seed: int) -> None:
    arrivals = make_arrivals(shape, seed)
    assert played(arrivals) == arrivals.expected()
