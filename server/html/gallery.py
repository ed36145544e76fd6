"""The front page: a picture of each stream, which leads to where it plays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from zlib import crc32

from markupsafe import Markup

from .htmlpage import STYLE, hash_source, read_text, rendered

MANY = 6
"""From so many streams on, they can be searched and sorted."""

FEW = 3
"""Up to so many streams have large cards; a single one fills the page."""

_HUES = 4

_STYLE = f"{STYLE}\n{read_text('gallery.css')}"
_SCRIPT = read_text("gallery.js")

SECURITY = (
    f"default-src 'none'; script-src {hash_source(_SCRIPT)}; style-src {hash_source(_STYLE)}; "
    "img-src 'self' data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; "
    "require-trusted-types-for 'script'; trusted-types 'none'"
)
"""The content security policy of the front page, which no other page may show in a frame."""


@dataclass(frozen=True, slots=True)
class Card:
    """A stream's entry on the front page."""

    name: str
    """Needs no quoting anywhere."""
    title: str
    poster: str | None = None
    seconds: float | None = None
    """How long it plays; None where this is not known, and for one picture."""
    live: bool = False
    about: str = ""

    @property
    def hue(self) -> int:
        """Which of the colours is behind its picture."""
        return crc32(self.name.encode()) % _HUES

    @property
    def clock(self) -> str:
        """How long it plays, as players show it."""
        return "" if self.seconds is None else clock_text(self.seconds)


def front_page(cards: Sequence[Markup], broken: Mapping[str, str], origin: str) -> str:
    """cards: what `card_html` gave for each stream. broken: by name of a stream that cannot be
    served, the reason. origin: scheme://host of the server."""
    return rendered(
        "gallery.html",
        title="swings",
        style=_STYLE,
        cards=cards,
        size=" one" if len(cards) == 1 else " few" if len(cards) <= FEW else "",
        broken=broken,
        origin=origin,
        script=_SCRIPT if len(cards) >= MANY else "",
    )


def card_html(card: Card) -> Markup:
    """The list item that shows `card`."""
    return Markup(rendered("card.html", card=card))


def clock_text(seconds: float) -> str:
    """As players show it: 0:00.7, 0:12, 12:34, 1:00:00; with tenths below ten seconds."""
    tenths = int(10 * seconds)
    if tenths < 100:
        return f"0:0{tenths // 10}.{tenths % 10}"
    minutes, left = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{left:02d}" if hours else f"{minutes}:{left:02d}"
