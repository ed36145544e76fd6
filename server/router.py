"""Which URL goes where.

Rule: a path is matched as it was sent; only names that a handler looks up in a table are unquoted.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from codec.stream.index import INDEX_NAME
from codec.stream.manifest import MANIFEST_NAME, MASKS
from codec.stream.sound import SOUND_NAME, SOUND_PREFIX
from server.abr.clientstatus import TOKEN

from .answers import objects, pages
from .answers.call import Answer, Call
from .answers.download import download
from .answers.play import play
from .answers.statusreport import answer_status
from .exchange.errors import RequestError
from .html.watchpage import DOWNLOAD_NAME

_NUMBER = "0|[1-9][0-9]{0,8}"

_NAMES = {
    "stream": r"[^/]+",
    "segment": _NUMBER,
    # What a segment has an object of; which of them there are, the stream says.
    "layer": f"{_NUMBER}|{MASKS}|snapshot-(?:{_NUMBER})|{SOUND_PREFIX}{SOUND_NAME}",
    "play": TOKEN,
    "asset": r".+",
    "picture": r".+\.[A-Za-z]{3,4}",
}
"""Regular expression of each placeholder of a path."""


@dataclass(frozen=True, slots=True)
class Route:
    """A kind of URL."""

    template: str
    """The path, with names in braces; also the route's label in metrics and logs."""
    methods: tuple[str, ...]
    handler: Callable[[Call], Answer]
    pattern: re.Pattern[str] = field(init=False)

    def __post_init__(self) -> None:
        parts = re.split(r"\{(\w+)\}", self.template)
        pattern = "".join(
            f"(?P<{part}>{_NAMES[part]})" if n % 2 else re.escape(part)
            for n, part in enumerate(parts)
        )
        object.__setattr__(self, "pattern", re.compile(pattern))


_READ = ("GET", "HEAD")
_STREAM = "/v1/streams/{stream}"

OBJECT_ROUTE = f"{_STREAM}/segments/{{segment}}/{{layer}}"

ROUTES: Sequence[Route] = (
    Route(OBJECT_ROUTE, _READ, objects.segment_object),
    Route(f"{_STREAM}/play/{{play}}", ("POST",), answer_status),
    Route(f"{_STREAM}/play", ("GET",), play),
    Route(f"{_STREAM}/{MANIFEST_NAME}", _READ, objects.manifest),
    Route(f"{_STREAM}/{INDEX_NAME}", _READ, objects.index),
    Route(f"{_STREAM}/{DOWNLOAD_NAME}", _READ, download),
    Route(f"{_STREAM}/oembed.json", _READ, pages.oembed),
    Route("/", _READ, pages.front),
    Route("/watch/{stream}", _READ, pages.watch),
    Route("/web/{asset}", _READ, objects.web_asset),
    Route("/healthz", _READ, pages.healthz),
    Route("/readyz", _READ, pages.readyz),
    Route("/metrics", _READ, pages.metrics),
    Route("/v1/streams", _READ, pages.streams),
    # Last: its name may hold anything but for its end.
    Route(f"{_STREAM}/{{picture}}", _READ, objects.picture),
)
"""All URLs of the server, the most used first."""


def find_route(method: str, path: str) -> tuple[Route, dict[str, str]]:
    """The route of a request, and the parts of `path` by their names.

    Raises RequestError 404 or 405.
    """
    for route in ROUTES:
        match = route.pattern.fullmatch(path)
        if match is not None:
            if method not in route.methods:
                allowed = ",".join(route.methods)
                raise RequestError(405, f"this URL accepts only {allowed}", {"Allow": allowed})
            return route, match.groupdict()
    raise RequestError(404, "nothing is served at this URL; /v1/streams lists the streams")
