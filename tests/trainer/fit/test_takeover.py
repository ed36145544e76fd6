"""A seam: slots take over the Gaussians of another training, all of them by its end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from codec.lattice.lattice import States
from codec.slots.slotencoder import SlotEncoder
from codec.slots.update import Update
from trainer.fit.trainer import Trainer
from trainer.lease.takeover import Crossfade, PlayerState, turns

from .test_leases import SLOTS, config, layout, sorted_rows
from .test_trainer import NEAR_M, Rendered, start

SEAM = range(1, 4)


def trained(swin_size: int, seed: int) -> tuple[Trainer, SlotEncoder, list[Update]]:
    """A trainer before its first window, an encoder for its updates, and the updates."""
    settings = replace(config(swin_size, active_share=0.4), seed=seed)
    slots = layout(swin_size, *SLOTS[swin_size])
    trainer = Trainer(settings, Rendered(), start(), NEAR_M, layout=slots)
    return trainer, SlotEncoder(slots), []


def test_after_a_seam_the_other_training_goes_on_as_if_it_had_been_heard_from_the_beginning() -> (
    None
):
    one, encoder, _ = trained(1, 0)
    other, other_encoder, _ = trained(1, 1)
    held: dict[int, PlayerState] = {}
    theirs: dict[int, Update] = {}
    for window in other.windows():
        for update in window.updates:
            other_encoder.append(update)
            theirs[update.birth] = update
        held |= {h.birth: h for h in other.held(window)}
    one.take_over(Crossfade({birth: held[birth] for birth in SEAM}, 1, 0))
    changed = []
    for window in one.windows():
        for update in window.updates:
            encoder.append(update)
        (mine,) = one.held(window)
        if window.first_frame in SEAM:
            wanted = held[window.first_frame]
            same = (mine.states.positions == wanted.states.positions).all(axis=1)
            changed.append(same.mean())
        # The shown Gaussians are those of a player.
        shown = sorted_rows(one.shown(window.first_frame))
        drawn = sorted_rows(mine.splats.take(np.flatnonzero(mine.shows)))
        assert np.array_equal(shown, drawn)
        if window.first_frame == SEAM[-1]:
            break
    assert changed[-1] == 1
    assert changed[0] < 0.6
    assert all(np.diff(changed) > -0.05)
    for birth in range(SEAM.stop, max(theirs) + 1):
        encoder.append(theirs[birth])  # raises if it does not fit
    for mine_slots, their_slots in zip(encoder.lanes[0], other_encoder.lanes[0], strict=True):
        for a, b in (
            (mine_slots.conditions, their_slots.conditions),
            (mine_slots.states.positions, their_slots.states.positions),
            (mine_slots.states.attributes, their_slots.states.attributes),
        ):
            assert np.array_equal(a, b)


@given(st.integers(1, 300), st.integers(1, 20), st.integers(0, 5))
def test_all_have_a_turn_and_as_many_each_time(num: int, count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    drawn = turns(rng.normal(size=(num, 3)).astype(np.float32), count, rng)
    assert drawn.min() >= 0
    assert drawn.max() < count
    sizes = np.bincount(drawn, minlength=count)
    assert sizes.max() - sizes.min() <= 4


def test_what_is_held_survives_as_arrays_and_as_an_opening() -> None:
    one, encoder, _ = trained(1, 0)
    window = next(one.windows())
    (update,) = window.updates
    encoder.append(update)
    (held,) = one.held(window)
    again = PlayerState.from_arrays(held.to_arrays())
    for name, array in held.to_arrays().items():
        assert np.array_equal(array, again.to_arrays()[name])
    opened = SlotEncoder.opened(encoder.layout, [held.as_opening()])
    assert opened.next_birth == encoder.next_birth == 1
    for a, b in zip(opened.lanes[0], encoder.lanes[0], strict=True):
        assert np.array_equal(a.conditions, b.conditions)
        assert np.array_equal(a.states.positions, b.states.positions)


def test_a_seam_needs_births_that_follow_each_other() -> None:
    held = PlayerState(
        0, States.zeros(2, 0), np.ones(2, np.bool_), np.zeros(2, np.bool_), np.zeros(2, np.uint8),
        start().take(np.arange(2)),
    )  # fmt: skip
    for births in ([], [1, 3]):
        with pytest.raises(InvalidError, match="seam"):
            Crossfade({birth: replace(held, birth=birth) for birth in births}, 1, 0)


def test_a_trainer_jumps_only_after_genesis() -> None:
    one, _, _ = trained(1, 0)
    with pytest.raises(InvalidError, match="after genesis"):
        one.jump(5)
