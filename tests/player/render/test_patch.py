"""The rectangles that cover the changes of a slice."""

from __future__ import annotations

import numpy as np
import pytest

from codec.errors import InvalidError
from codec.slice import Slice
from player.render.patch import PackedLanes
from tests.support.hosted_streams import random_slice, random_splats


def test_what_is_handed_out_does_not_change() -> None:
    lanes = PackedLanes(2, 1000, 0, columns=512)
    whole = lanes.pack(random_slice(0, 1000, 0))
    handed = [patch.texels.copy() for patch in whole.patches]
    rows = np.arange(0, 1000, 2, dtype=np.int32)
    parts = []
    for birth in (2, 4):
        splats = random_splats(500, 0, birth)
        parts.append(lanes.pack(Slice(birth, splats, np.zeros(500, np.uint8), rows)))
        handed += [patch.texels.copy() for patch in parts[-1].patches]
    after = [patch.texels for packed in (whole, *parts) for patch in packed.patches]
    for before, texels in zip(handed, after, strict=True):
        np.testing.assert_array_equal(before, texels)
    # Unchanged texels in between are uploaded unchanged.
    np.testing.assert_array_equal(parts[1].patches[0].texels[0, 4:8], handed[0][0, 4:8])

    part = Slice(3, splats, np.zeros(500, np.uint8), rows)
    with pytest.raises(InvalidError, match="its lane holds nothing"):
        lanes.pack(part)
