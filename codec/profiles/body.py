"""What every profile does: Gaussians to the body of a chunk and back.

The modules `raw`, `paper` and `compact` are codings; `Profile.coding` finds the one of a profile.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from codec.splats import Splats

from .quantise import Steps


@dataclass(frozen=True, slots=True)
class Body:
    """The attributes of the Gaussians of a chunk, encoded."""

    data: bytes
    edges: Sequence[int]
    """Offsets in `data`, from 0 to its end, between its parts; none if all of it is float32."""
    order: npt.NDArray[np.int64] | None = None
    """(N,) the Gaussians in the order that `data` has them; None if that is the order given."""


class Coding(Protocol):
    """One profile. Decoding needs nothing but the body, the count and the SH degree."""

    CODE: int
    """The number of the profile in the header of a chunk."""

    def encode(self, splats: Splats, steps: Steps | None) -> Body:
        """The body of `splats`, quantised by `steps`, or by steps that suit these Gaussians.

        Raises InvalidError for what the profile cannot hold.
        """
        ...

    def decode(self, body: memoryview, count: int, sh_degree: int) -> Splats:
        """The Splats in `body`. Raises CorruptError (format) or InvalidError (values)."""
        ...

    def edges(self, body: memoryview, count: int, sh_degree: int) -> list[int]:
        """The edges of a body that was made elsewhere and can be decoded, see `Body.edges`."""
        ...

    def layer_steps(self, layers: Sequence[Splats]) -> Sequence[Steps | None]:
        """For each layer of one slice the steps to encode it with."""
        ...
