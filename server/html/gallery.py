"""The front page: a picture of each stream, which leads to where it plays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from urllib.parse import quote

from .htmlpage import page

_CARD = """<li><a class="card" href="watch/{name}">
<span class="picture">{picture}{badge}<span class="tag">{length}</span></span>
<span class="title">{title}</span><span class="quiet">{about}</span>
</a></li>"""

_PICTURE = '<img src="v1/streams/{name}/{poster}" alt="" loading="lazy">'
_BADGE = '<span class="tag live">LIVE</span>'

_FRONT = """<h1>Streams</h1>
<ul class="streams">
{cards}
</ul>
<footer>On a desktop, <code>swings-play {origin}/watch/NAME</code> plays one too.</footer>"""

_NONE = """<h1>There are no streams here yet</h1>
<p>Put one into the folder that is served, with <code>swings-train</code> or
<code>swings-stream import</code>; it shows here within a second.</p>"""

_MISSING = """<h1>There is no such stream</h1>
<p>See <a href="{front}">all streams</a>.</p>"""


@dataclass(frozen=True, slots=True)
class Card:
    """What the front page says of a stream."""

    name: str
    """Needs no quoting anywhere."""
    title: str
    poster: str | None
    seconds: float
    live: bool
    about: str


def front_page(cards: Sequence[Card], origin: str) -> str:
    """origin: scheme://host of the server."""
    if not cards:
        return page("swings", _NONE)
    listed = "\n".join(map(_card, cards))
    return page("swings", _FRONT.format(cards=listed, origin=origin))


def missing_page(front: str) -> str:
    """What stands where no stream is. front: URL of the front page."""
    return page("swings", _MISSING.format(front=front))


def _card(card: Card) -> str:
    picture = ""
    if card.poster:
        picture = _PICTURE.format(name=card.name, poster=escape(quote(card.poster)))
    return _CARD.format(
        name=card.name,
        picture=picture,
        badge=_BADGE if card.live else "",
        length=clock_text(card.seconds),
        title=escape(card.title),
        about=escape(card.about),
    )


def clock_text(seconds: float) -> str:
    """As players show it: 0:05, 12:34, 1:00:00."""
    minutes, left = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{left:02d}" if hours else f"{minutes}:{left:02d}"
