"""The page of one stream: the player, and around it what a page to be shared has."""

from __future__ import annotations

from dataclasses import dataclass

from markupsafe import Markup

from codec.stream.packedlayout import PACKED_SUFFIX

from .htmlpage import STYLE, hash_source, read_text, rendered
from .webplayer import WebPlayer

_STYLE = f"{STYLE}\n{read_text('watch.css')}"

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
        f"style-src {hash_source(_STYLE)}; base-uri 'none'; form-action 'none'; "
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
        style=_STYLE,
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
