"""Fonts for the names of cameras: matplotlib's own has no Chinese, Japanese or Korean letters."""

from __future__ import annotations

from collections.abc import Iterable

from matplotlib.font_manager import FontProperties, findfont, fontManager
from matplotlib.ft2font import FT2Font

OWN_FAMILY = "DejaVu Sans"
"""Comes with matplotlib."""

STAND_INS = frozenset({"Last Resort High-Efficiency"})
"""Fonts whose glyphs are boxes for every letter."""


def families_for(texts: Iterable[str]) -> list[str] | None:
    """Families of installed fonts that together have all letters of `texts`, to try one after the
    other; None if no font has those that matplotlib's own lacks."""
    own = FT2Font(findfont(FontProperties(family=[OWN_FAMILY])))
    lacking = {ord(letter) for text in texts for letter in text} - own.get_charmap().keys()
    if not lacking:
        return [OWN_FAMILY]
    for entry in fontManager.ttflist:
        if entry.name in STAND_INS or entry.style != "normal":
            continue
        try:
            letters = FT2Font(entry.fname).get_charmap().keys()
        except (OSError, RuntimeError):  # has been removed, or is broken
            continue
        if lacking <= letters:
            return [OWN_FAMILY, entry.name]
    return None
