"""The GPU's sort, compared with a stable sort."""

from __future__ import annotations

from collections.abc import Iterator

import moderngl
import numpy as np
import numpy.typing as npt
import pytest

from player.render.gl import open_context
from player.render.gl.context import Unlocked
from player.render.gl.passes import ABSENT, BLOCK, KEY_BITS, DepthSort
from player.render.renderer import GlVersion
from tests.support.screen.opengl import NO_GL43

pytestmark = pytest.mark.skipif(NO_GL43 is not None, reason=f"OpenGL: {NO_GL43}")

Keys = npt.NDArray[np.uint32]


@pytest.fixture
def context() -> Iterator[moderngl.Context]:
    opened = open_context(GlVersion.V43)
    yield opened
    opened.release()


def some_keys(count: int, kinds: int, absent_share: float, seed: int) -> Keys:
    """Keys with at most `kinds` different values, so that many are equal."""
    rng = np.random.default_rng(seed)
    values = rng.integers(0, 1 << KEY_BITS, kinds)
    keys = values[rng.integers(0, kinds, count)].astype(np.uint32)
    keys[rng.random(count) < absent_share] = ABSENT
    return keys


def expected_order(keys: Keys) -> npt.NDArray[np.intp]:
    shown = np.flatnonzero(keys != ABSENT)
    return shown[np.argsort(keys[shown], kind="stable")]


@pytest.mark.parametrize("count", [1, 2, 1000, BLOCK, BLOCK + 1, 70_001])
@pytest.mark.parametrize(("kinds", "absent_share"), [(1, 0.0), (30, 0.5), (10**6, 0.1), (9, 1.0)])
def test_equal_keys_keep_their_order_and_absent_ones_are_left_out(
    context: moderngl.Context, count: int, kinds: int, absent_share: float
) -> None:
    sort = DepthSort(context, count)
    # The second sort has different and fewer keys.
    for absent in (absent_share, 1 - (1 - absent_share) / 3):
        keys = some_keys(count, kinds, absent, count)
        slots = np.random.default_rng(1).permutation(count).astype(np.uint32)
        sort.keys.write(keys)
        sort.slots.write(slots)
        sort.run(Unlocked(context))
        expected = expected_order(keys)
        command = np.frombuffer(sort.command.read(), np.uint32)
        assert command.tolist() == [4, len(expected), 0, 0]
        got = np.frombuffer(sort.order.read(), np.int32)[: len(expected)]
        np.testing.assert_array_equal(got, slots[expected])
