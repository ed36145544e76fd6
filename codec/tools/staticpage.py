"""A page and the browser player beside the files of a static export."""

from __future__ import annotations

from html import escape
from importlib.util import find_spec
from pathlib import Path

from codec.errors import InvalidError
from codec.files import write_atomic
from codec.stream.manifest import Manifest

PAGE_NAME, PLAYER_FOLDER = "index.html", "player"
INLINE = ("page.js", "watch.html")
"""Files of the bundle that become part of the page."""
TITLE, PLACE = "<title>swings</title>", '="./'
"""What the page of the bundle says, to be replaced."""


def write_page(folder: Path, manifest: Manifest) -> None:
    """Puts PAGE_NAME and PLAYER_FOLDER into the `folder` of a stream, which the page plays. Raises
    InvalidError where the browser player is not installed."""
    bundle = _bundle()
    page = (bundle / "watch.html").read_text(encoding="utf-8")
    title = escape(manifest.title or "swings")
    head = f'<title>{title}</title>\n    <meta property="og:title" content="{title}" />'
    page = page.replace(TITLE, head, 1).replace(PLACE, f"{PLACE}{PLAYER_FOLDER}/")
    (folder / PLAYER_FOLDER).mkdir()
    for path in sorted(bundle.iterdir()):
        if path.name not in INLINE:
            write_atomic(folder / PLAYER_FOLDER / path.name, path.read_bytes())
    write_atomic(folder / PAGE_NAME, page.encode())


def _bundle() -> Path:
    # By its name: the codec does not import the player.
    spec = find_spec("player")
    for place in spec.submodule_search_locations or () if spec is not None else ():
        folder = Path(place) / "web" / "bundle"
        if (folder / "watch.html").is_file():
            return folder
    raise InvalidError("--page: the browser player is not installed; reinstall swings")
