"""The front page: a picture of each stream, which leads to where it plays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from urllib.parse import quote
from zlib import crc32

from .htmlpage import STYLE, hash_source, page, read_text

MANY = 6
"""From so many streams on, they can be searched and sorted."""

FEW = 3
"""Up to so many streams have large cards; a single one fills the page."""

_CARD = """<li data-seconds="{seconds}"><a class="card" href="watch/{name}">
<span class="picture hue-{hue}">{picture}{badge}{length}</span>
<span class="title">{title}</span><span class="quiet">{about}</span>
</a></li>"""

_INITIAL = '<span class="initial" aria-hidden="true">{initial}</span>'
_PICTURE = '<img src="v1/streams/{name}/{poster}" alt="" loading="lazy" decoding="async">'
_LENGTH = '<span class="tag">{clock}</span>'
_BADGE = '<span class="tag live">LIVE</span>'
_HUES = 4

_FIND = """<form class="find" role="search" hidden>
<output class="quiet"></output>
<input type="search" aria-label="Search streams" placeholder="Search" autocomplete="off">
<select aria-label="Order of streams"><option value="title">Title</option>
<option value="longest">Longest first</option><option value="shortest">Shortest first</option>
</select></form>"""

_FRONT = """<main>
<div class="head"><h1>{heading}</h1>{find}</div>
<ul class="streams{few}">
{cards}
</ul>
{broken}</main>
<footer class="quiet">On a desktop, <code>swings-play {origin}/watch/NAME</code> also plays a
stream.</footer>{script}"""

_NONE = """<main><div class="head"><h1>No streams yet</h1></div>
<p>Add a stream to the served folder with <code>swings-train</code> or
<code>swings-stream import</code>; it appears here within a second.</p>
{broken}</main>"""

_BROKEN = """<details class="broken"><summary>{count} cannot be played</summary>
<ul>{rows}</ul></details>"""

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


def front_page(cards: Sequence[str], broken: Mapping[str, str], origin: str) -> str:
    """cards: what `card_html` gave for each stream. broken: by name of a stream that cannot be
    served, the reason. origin: scheme://host of the server."""
    listed = _broken_html(broken)
    if not cards:
        return page("swings", _NONE.format(broken=listed), style=_STYLE)
    many = len(cards) >= MANY
    body = _FRONT.format(
        heading=f"{len(cards)} streams" if len(cards) > 1 else "1 stream",
        find=_FIND if many else "",
        few=" one" if len(cards) == 1 else " few" if len(cards) <= FEW else "",
        cards="\n".join(cards),
        broken=listed,
        origin=origin,
        script=f"\n<script>{_SCRIPT}</script>" if many else "",
    )
    return page("swings", body, style=_STYLE)


def card_html(card: Card) -> str:
    """The list item that shows `card`."""
    picture = _INITIAL.format(initial=escape(card.title[:1].upper()))
    if card.poster:
        picture += _PICTURE.format(name=card.name, poster=escape(quote(card.poster)))
    return _CARD.format(
        name=card.name,
        picture=picture,
        hue=crc32(card.name.encode()) % _HUES,
        badge=_BADGE if card.live else "",
        length="" if card.seconds is None else _LENGTH.format(clock=clock_text(card.seconds)),
        seconds=0 if card.seconds is None else round(card.seconds, 1),
        title=escape(card.title),
        about=escape(card.about),
    )


def _broken_html(broken: Mapping[str, str]) -> str:
    if not broken:
        return ""
    rows = "".join(
        f"<li><code>{escape(name)}</code>: {escape(reason)}</li>"
        for name, reason in sorted(broken.items())
    )
    count = f"{len(broken)} streams" if len(broken) > 1 else "1 stream"
    return _BROKEN.format(count=count, rows=rows)


def clock_text(seconds: float) -> str:
    """As players show it: 0:00.7, 0:12, 12:34, 1:00:00; with tenths below ten seconds."""
    tenths = int(10 * seconds)
    if tenths < 100:
        return f"0:0{tenths // 10}.{tenths % 10}"
    minutes, left = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{left:02d}" if hours else f"{minutes}:{left:02d}"
