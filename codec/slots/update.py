"""What a slice changes of its lane's slots, as a trainer hands it over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from codec.splats import Splats

from .lattice import States

KEPT, ENDED, PREDICTED, NEW = range(4)
"""What a slice says of a slot."""


@dataclass(frozen=True, slots=True)
class Update:
    """The slice born at `birth`, of S slots, layer after layer, of which M are predicted or new."""

    birth: int
    statuses: npt.NDArray[np.uint8]  # (S,)
    states: States  # (M) absolute values, in the order of the slots
    start_offsets: npt.NDArray[np.uint8]  # (M,) frames after birth
    escaped: npt.NDArray[np.bool_]  # (M,) which of them no lattice holds: `escapes` has those
    escapes: Splats
