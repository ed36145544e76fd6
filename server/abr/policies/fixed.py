"""The same number of layers whatever happens: what `?layers=N` asks for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from codec.errors import InvalidError

from .situation import Situation


@dataclass(frozen=True, slots=True)
class FixedRule:
    """Chooses `num_layers`, or as many as there are."""

    num_layers: int
    """At least 1 (the query)."""

    horizon: ClassVar[int] = 1

    def __post_init__(self) -> None:
        if self.num_layers < 1:
            raise InvalidError(f"layers is {self.num_layers}; give at least 1")

    def choose_layers(self, situation: Situation) -> int:
        return min(self.num_layers, situation.most_layers)
