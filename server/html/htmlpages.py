"""The pages of the server, from templates of jinja2: the front page with a card for each stream,
the page of one stream around its player, and messages.

Rule: a page's content security policy names what it has inline by its hash. A card shows the
stream's poster, see codec/stream/poster.py.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from importlib.resources import files
from zlib import crc32

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from codec.stream.packedlayout import PACKED_SUFFIX

from .webplayer import WebPlayer

_TEMPLATES = Environment(
    loader=PackageLoader(__package__),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    auto_reload=False,
)


def rendered(template: str, **values: object) -> str:
    """The template with its values, which are text and not HTML, but for what is Markup."""
    return _TEMPLATES.get_template(template).render(values)


def read_text(name: str) -> str:
    """A file that lies beside this module."""
    return (files(__package__) / name).read_text(encoding="utf-8").strip()


def hash_source(text: str) -> str:
    """The source expression of a policy that allows the inline script or style `text`."""
    return f"'sha256-{b64encode(sha256(text.encode()).digest()).decode()}'"


STYLE = read_text("page.css")
"""The styles of all pages."""

PLAIN_SECURITY = (
    f"default-src 'none'; style-src {hash_source(STYLE)}; img-src 'self' data:; "
    "base-uri 'none'; form-action 'none'"
)
"""The content security policy of a page without scripts and without a style of its own."""


def message_page(heading: str, text: str) -> str:
    """A page that says one thing. text: with links if it is Markup."""
    return rendered("message.html", title=heading, text=text, style=STYLE)


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


_WATCH_STYLE = f"{STYLE}\n{read_text('watch.css')}"

_ALLOW = (
    "autoplay; fullscreen; xr-spatial-tracking; clipboard-write; web-share; gyroscope; "
    "accelerometer"
)
"""Permissions of a frame: sound, full screen, headsets, links, sharing, turning with the phone."""

_FRAME = Markup(
    '<iframe src="{url}" title="{title}" width="{width_px}" height="{height_px}" '
    'style="border: 0" allow="{allow}"></iframe>'
)

DOWNLOAD_NAME = f"stream{PACKED_SUFFIX}"
"""The name under which a stream is one file, beside its manifest."""

WIDTH_PX = 720
"""Width of the frame in the code to embed a stream."""


@dataclass(frozen=True, slots=True)
class WatchedStream:
    """The description of a stream on its page."""

    name: str
    """Needs no quoting anywhere."""
    title: str
    about: str
    """A description in one line."""
    origin: str
    """scheme://host of the server."""
    aspect: float
    """Width of the picture as a share of its height."""
    poster: str = ""
    """Path of the poster behind the stream's URL, quoted; empty where it has none."""
    poster_px: tuple[int, int] | None = None
    """Width and height of the poster; None where they are not known."""
    is_live: bool = False
    sh_degree: int = 0

    @property
    def url(self) -> str:
        """The address of the page."""
        return f"{self.origin}/watch/{self.name}"

    @property
    def data_url(self) -> str:
        """The address of the stream, without a slash at its end."""
        return f"{self.origin}/v1/streams/{self.name}"


def security(player: WebPlayer) -> str:
    """The content security policy of the page. Pages of other hosts may show it in a frame."""
    return (
        f"default-src 'none'; script-src 'self' {hash_source(player.page_script)}; "
        f"worker-src 'self'; connect-src 'self'; img-src 'self' data:; media-src 'self'; "
        f"style-src {hash_source(_WATCH_STYLE)}; base-uri 'none'; form-action 'none'; "
        "require-trusted-types-for 'script'; trusted-types swings-worker"
    )


def watch_page(stream: WatchedStream, player: WebPlayer, shared: bool) -> str:
    """shared: whether anyone may open the page by its address; else the page names no address that
    leads elsewhere than below its own."""
    data = f"../v1/streams/{stream.name}"
    modules = [*player.modules, *([player.harmonics] if stream.sh_degree >= 2 else [])]
    return rendered(
        "watch.html",
        title=stream.title,
        style=_WATCH_STYLE,
        stream=stream,
        shared=shared,
        frame_px=frame_px(stream.aspect),
        code=str(frame_html(stream)),
        data=data,
        file="" if stream.is_live else f"{data}/{DOWNLOAD_NAME}",
        script=player.page_script,
        modules=[f"../web/{name}" for name in modules],
    )


def frame_px(
    aspect: float, max_width_px: int | None = None, max_height_px: int | None = None
) -> tuple[int, int]:
    """Width and height of the frame to embed, within both limits."""
    width_px = min(WIDTH_PX, max_width_px or WIDTH_PX)
    if max_height_px is not None:
        width_px = min(width_px, int(max_height_px * aspect))
    width_px = max(1, width_px)
    return width_px, max(1, int(width_px / aspect))


def frame_html(stream: WatchedStream, size_px: tuple[int, int] | None = None) -> Markup:
    """The code that shows the stream on another page. size_px: width and height."""
    width_px, height_px = size_px or frame_px(stream.aspect)
    return _FRAME.format(
        url=stream.url, title=stream.title, width_px=width_px, height_px=height_px, allow=_ALLOW
    )


def oembed(
    stream: WatchedStream, max_width_px: int | None = None, max_height_px: int | None = None
) -> dict[str, object]:
    """The response of oEmbed 1.0 (https://oembed.com) for the page."""
    size_px = frame_px(stream.aspect, max_width_px, max_height_px)
    found: dict[str, object] = {
        "version": "1.0",
        "type": "video",
        "provider_name": "swings",
        "provider_url": f"{stream.origin}/",
        "title": stream.title,
        "html": str(frame_html(stream, size_px)),
        "width": size_px[0],
        "height": size_px[1],
    }
    if stream.poster_px is not None:
        width_px, height_px = stream.poster_px
        # A thumbnail keeps to the limits of the frame, by the standard.
        if width_px <= (max_width_px or width_px) and height_px <= (max_height_px or height_px):
            found["thumbnail_url"] = f"{stream.data_url}/{stream.poster}"
            found["thumbnail_width"] = width_px
            found["thumbnail_height"] = height_px
    return found
