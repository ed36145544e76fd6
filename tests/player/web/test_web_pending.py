"""Updates that wait for a renderer: the newest of each slot, and never more than one of each."""

from __future__ import annotations

import random

import pytest

from tests.support.web.browsercode import BrowserCode

NUM_SLOTS = 50


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("sh_degree", [0, 1])
def test_the_newest_of_each_slot(browser: BrowserCode, sh_degree: int, seed: int) -> None:
    rng = random.Random(seed)
    expected = [0] * NUM_SLOTS
    updates = []
    for number in range(200):
        lattice, floats = (
            [[slot, rng.randrange(1, 2**31)] for slot in rng.sample(range(NUM_SLOTS), count)]
            for count in (rng.randrange(20), rng.randrange(4))
        )
        # In the order of renderers: the lattice first.
        for slot, value in lattice + floats:
            expected[slot] = value
        is_handed = rng.random() < 0.05 or number == 199
        updates.append({"lattice": lattice, "floats": floats, "isHanded": is_handed})
    question = {"numSlots": NUM_SLOTS, "shDegree": sh_degree, "updates": updates}
    found = browser.ask("pending", **question)
    assert found["values"] == expected
    assert found["mostEntries"] <= NUM_SLOTS
