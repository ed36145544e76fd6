"""Notes of readers about foreign files, and the state that the files of one import share.

A frame is read two or three times, and a sequence has many: each note is logged once in an import.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field

from codec.arrays import Doubles

_log = logging.getLogger(__name__)

MAX_NAMED = 3
"""Files of which a note names what was left out; further ones are only counted."""


@dataclass
class Notes:
    """Notes on the files of one import."""

    place: str = ""
    """The file that is read now."""
    centre: Doubles | None = None
    """(3,) metres that are taken away from all positions before they become float32; None until a
    file needs it."""
    left_out: dict[str, int] = field(default_factory=dict)
    """Gaussians that were left out, by file."""
    hint: str = ""
    """A remedy for a model that looks wrong, where its file leaves something open."""
    _said: set[str] = field(default_factory=set)

    def say(self, text: str, kind: str | None = None) -> None:
        """Logs `text`, which is about the present file, unless the same was said before. kind:
        what counts as the same, if files differ in their texts."""
        if (kind or text) in self._said:
            return
        self._said.add(kind or text)
        _log.warning("%s%s", f"{self.place}: " if self.place else "", text)

    def leave_out(self, count: int, text: str) -> None:
        """Counts Gaussians of the present file that are left out; `text` is about them."""
        is_new = self.place not in self.left_out
        self.left_out[self.place] = count
        if len(self.left_out) <= MAX_NAMED:
            self.say(text, f"{self.place} {text}")
        elif is_new and len(self.left_out) == MAX_NAMED + 1:
            self.say("lacks some, too; further files are only counted")


_current: ContextVar[Notes | None] = ContextVar("notes", default=None)


def notes() -> Notes:
    """The notes of the import that runs, or new ones for a file that is read by itself."""
    return _current.get() or Notes()


@contextmanager
def one_import() -> Iterator[Notes]:
    """Makes all files that are read in the block share one Notes."""
    made = Notes()
    token = _current.set(made)
    try:
        yield made
    finally:
        _current.reset(token)


@contextmanager
def reading(place: object) -> Iterator[None]:
    """Makes the notes in the block name `place`."""
    found = _current.get()
    if found is None:
        with one_import() as found:
            found.place = str(place)
            yield
        return
    before, found.place = found.place, str(place)
    try:
        yield
    finally:
        found.place = before


ANTIALIASED, FLAT = "antialiased", "2dgs"
"""How a file says that its Gaussians were trained: with opacity compensation, or as flat ones."""


def tell_model(model: str) -> None:
    """Says what becomes of Gaussians that were trained as `model`, whatever sign of a file gave it
    away: a Splats has no place for it."""
    if model == ANTIALIASED:
        notes().say(
            "trained with opacity compensation (antialiased, Mip-Splatting), which is left out: "
            "small Gaussians may look too bright",
            ANTIALIASED,
        )
    elif model == FLAT:
        notes().say("2D Gaussians (two sizes) are read as flat ones", FLAT)
    elif model not in ("", "default"):
        notes().say(f"trained as {model[:40]!r}, which is not known: read as 3D Gaussians", model)
