"""The front page: a picture of each stream, which leads to where it plays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from urllib.parse import quote

from .htmlpage import page

_CARD = """<li><a class="card" href="watch/{name}">
<span class="picture">{picture}{badge}{length}</span>
<span class="title">{title}</span><span class="quiet">{about}</span>
</a></li>"""

_PICTURE = '<img src="v1/streams/{name}/{poster}" alt="" loading="lazy">'
_LENGTH = '<span class="tag">{clock}</span>'
_BADGE = '<span class="tag live">LIVE</span>'

_FRONT = """<h1>Streams</h1>
<ul class="streams">
{cards}
</ul>
<footer>On a desktop, <code>swings-play {origin}/watch/NAME</code> also plays a stream.</footer>"""

_NONE = """<h1>No streams yet</h1>
<p>Add a stream to the served folder with <code>swings-train</code> or
<code>swings-stream import</code>; it appears here within a second.</p>"""

_MISSING = """<h1>Stream not found</h1>
<p>See <a href="{front}">all streams</a>.</p>"""


@dataclass(frozen=True, slots=True)
class Card:
    """What the front page says of a stream."""

    name: str
    """Needs no quoting anywhere."""
    title: str
    poster: str | None = None
    seconds: float | None = None
    """How long it plays; None where this is not known."""
    live: bool = False
    about: str = ""


def front_page(cards: Sequence[str], origin: str) -> str:
    """cards: what `card_html` gave for each stream. origin: scheme://host of the server."""
    if not cards:
        return page("swings", _NONE)
    return page("swings", _FRONT.format(cards="\n".join(cards), origin=origin))


def missing_page(front: str) -> str:
    """What stands where no stream is. front: URL of the front page."""
    return page("swings", _MISSING.format(front=front))


def card_html(card: Card) -> str:
    """The list item that shows `card`."""
    picture = ""
    if card.poster:
        picture = _PICTURE.format(name=card.name, poster=escape(quote(card.poster)))
    return _CARD.format(
        name=card.name,
        picture=picture,
        badge=_BADGE if card.live else "",
        length="" if card.seconds is None else _LENGTH.format(clock=clock_text(card.seconds)),
        title=escape(card.title),
        about=escape(card.about),
    )


def clock_text(seconds: float) -> str:
    """As players show it: 0:05, 12:34, 1:00:00."""
    minutes, left = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{left:02d}" if hours else f"{minutes}:{left:02d}"
