"""The motion of all slots of a stream between two of its frames, however far apart."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from codec.errors import InvalidError
from codec.halfway import Motion
from codec.slice import Slice
from codec.splats import Splats


def motion_between(
    before: Sequence[Slice], changes: Iterable[Slice], after: Sequence[Slice]
) -> Motion:
    """The motion from the frame of the window `before` to that of the window `after`.

    before, after: all whole slices of a window, oldest first, each with all slots of its lane.
    changes: the slices between them, with their motion. A slot that any of them gives to another
    Gaussian, or that jumps in one, does not go on. The rows count the slots of all lanes in the
    order of `after`, in which equally far ones are drawn.
    """
    swin_size, count = len(before), len(before[0].splats)
    frame, later = before[-1].birth, after[-1].birth
    renewed = np.zeros((swin_size, count), np.bool_)
    for slice in changes:
        if slice.rows is None or slice.motion is None:
            raise InvalidError(f"the slice born at {slice.birth} does not report its motion")
        goes_on = slice.motion.rows[~slice.motion.enters]
        renewed[slice.lane(swin_size), np.setdiff1d(slice.rows, goes_on)] = True
    lanes = [slice.lane(swin_size) for slice in after]
    held = {slice.lane(swin_size): slice for slice in before}
    first = [held[lane] for lane in lanes]
    return Motion.of(
        np.arange(swin_size * count, dtype=np.int32),
        Splats.concatenate([slice.splats for slice in first]),
        np.concatenate([slice.active(frame, swin_size) for slice in first]),
        Splats.concatenate([slice.splats for slice in after]),
        np.concatenate([slice.active(later, swin_size) for slice in after]),
        renewed[lanes].ravel(),
    )
