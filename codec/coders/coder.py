"""A chunk as an entropy coder takes it: what its bytes become in an object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class EncodedChunk:
    """The bytes of a chunk, and what an entropy coder should know of them."""

    birth: int
    data: bytes
    edges: Sequence[int]
    """Offsets in `data`, from 0 to its end, between planes or attributes; none if all of it is
    float32."""
    sh_degree: int | None = None
    """That of a change, whose planes a packet may code by themselves; None of other chunks."""
