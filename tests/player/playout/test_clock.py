"""The clock of a playback: stopped, slowed down and sped up, with a fake real time."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from player.playout.clock import MAX_RATE, MIN_RATE, Clock
from tests.player.playout.conducted import World


@given(
    st.lists(
        st.tuples(
            st.floats(0, 10), st.sampled_from(["stop", "start"]) | st.floats(MIN_RATE, MAX_RATE)
        )
    )
)
def test_it_shows_the_time_that_ran_at_the_rate_that_it_had(
    events: list[tuple[float, str | float]],
) -> None:
    world = World()
    clock = Clock(True, world)
    expected_s, running, rate = 0.0, True, 1.0
    for passed_s, event in events:
        world.now_s += passed_s
        expected_s += passed_s * rate * running
        assert clock.now_s() == pytest.approx(expected_s)
        if event == "stop":
            clock.stop()
        elif event == "start":
            clock.start()
        else:
            assert isinstance(event, float)
            clock.set_rate(event)
            rate = event
        running = running if isinstance(event, float) else event == "start"
        assert clock.now_s() == pytest.approx(expected_s)
        assert (clock.running, clock.rate) == (running, rate)


def test_waiting_is_in_seconds_of_the_world_and_skipping_goes_on_only() -> None:
    world = World()
    clock = Clock(True, world)
    clock.set_rate(0.25)
    assert clock.until_s(1.0) == pytest.approx(4.0)
    clock.set_rate(4.0)
    assert clock.until_s(1.0) == pytest.approx(0.25)
    world.now_s += 1
    assert clock.until_s(1.0) == 0
    clock.stop()
    assert clock.until_s(99.0) is None
    assert clock.until_s(1.0) == 0
    assert Clock(False, world).until_s(99.0) == 0
    for place_s in (7.0, 5.0):
        clock.skip_to(place_s)
        assert clock.now_s() == 7.0
    for rate in (0.0, -1.0, 0.09, 4.1, float("nan"), float("inf")):
        with pytest.raises(InvalidError, match="rate"):
            clock.set_rate(rate)
