"""The browser player as it is installed: its files, and the page of one stream."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from html import escape
from importlib.util import find_spec
from pathlib import Path

from codec.errors import InvalidError

SECURITY = (
    "default-src 'none'; script-src 'self' blob:; worker-src 'self' blob:; connect-src *; "
    "img-src * data:; style-src 'unsafe-inline'; base-uri 'self'; form-action 'none'"
)
"""The content security policy of the page: its workers begin in a blob, what it plays may come from
another host, and pages of other hosts may show it in a frame."""

_TYPES = {".js": "text/javascript", ".html": "text/html"}

_PAGE = "watch.html"
_HEAD, _TITLE, _BODY = "<head>", "<title>swings</title>", "<body></body>"


@dataclass(frozen=True, slots=True)
class Asset:
    """One file."""

    data: bytes
    sha256: str
    content_type: str


class WebPlayer:
    """All files of player/web, in memory: a request finds one by its name in a table."""

    def __init__(self, folder: Path | None = None) -> None:
        """folder: None for the one that is installed. Raises InvalidError where it is not whole."""
        folder = folder or _installed()
        self.assets = {
            path.relative_to(folder).as_posix(): _asset(path)
            for path in sorted(folder.rglob("*"))
            if path.suffix in _TYPES
        }
        page = self.assets.get(_PAGE)
        self._page = page.data.decode() if page is not None else ""
        if any(self._page.count(mark) != 1 for mark in (_HEAD, _TITLE, _BODY)):
            raise InvalidError(f"{folder} does not hold the browser player; reinstall swings")

    def watch_page(self, title: str, base: str, hint: str) -> str:
        """The page of one stream. title, hint: plain text, the second for who has no scripts;
        base: URL of the player's files."""
        replaced = self._page.replace(_HEAD, f'{_HEAD}\n    <base href="{base}" />')
        replaced = replaced.replace(_TITLE, f"<title>{escape(title)}</title>")
        return replaced.replace(_BODY, f"<body><noscript>{escape(hint)}</noscript></body>")


def _installed() -> Path:
    # By its name: the server does not import the player.
    spec = find_spec("player")
    if spec is None or not spec.submodule_search_locations:
        raise InvalidError("the browser player is not installed; reinstall swings")
    return Path(spec.submodule_search_locations[0]) / "web"


def _asset(path: Path) -> Asset:
    data = path.read_bytes()
    return Asset(data, hashlib.sha256(data).hexdigest(), _TYPES[path.suffix])
