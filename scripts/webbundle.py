"""Builds the bundle of player/web: a page and its scripts instead of a hundred modules.

Run by scripts/webbundle. The bundle is committed, so that an installation of swings needs no
Node.js; a test compares it with the sources.
"""

from __future__ import annotations

import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[1]
WEB = ROOT / "player" / "web"
NODE_MODULES = WEB / "node_modules"

MODULES = {
    "player.js": "element/swingsplayer.js",
    "playworker.js": "playback/playworker.js",
    "sortworker.js": "playback/sortworker.js",
    "controls.js": "element/controls.js",
    "extras.js": "element/extras.js",
    "tracks.js": "element/tracks.js",
    "smoothing.js": "element/smoothing.js",
    "packedlayout.js": "format/packedlayout.js",
    "passing.js": "format/slots/passing.js",
    "ply.js": "format/ply.js",
    "gaussianfeed.js": "feed/gaussianfeed.js",
    "feedworker.js": "feed/feedworker.js",
}
"""Each module of the bundle and its entry point in the sources."""

LATER = {
    "controls.js",
    "extras.js",
    "tracks.js",
    "smoothing.js",
    "packedlayout.js",
    "passing.js",
    "ply.js",
    "gaussianfeed.js",
    "feedworker.js",
}
"""Modules that are loaded after the first requests, or when a viewer, stream or page needs them."""

PAGE_SCRIPT, PAGE_SOURCE = "page.js", "watch.js"
"""The script that pages contain inline, so that it sends the first requests at once."""

PAGE = "watch.html"

_SCRIPTS = """\
    <script type="module" src="./watch.js"></script>
    <script type="module" src="./element/swingsplayer.js"></script>
"""
_HEAD_END = "  </head>\n"


NAMES = (*MODULES, PAGE_SCRIPT, PAGE)
"""The files of the bundle."""


def built(name: str) -> str:
    """One of the files. Raises CalledProcessError if a source is wrong."""
    if name == PAGE:
        return _page((WEB / PAGE).read_text(encoding="utf-8"), built(PAGE_SCRIPT))
    if name == PAGE_SCRIPT:
        return _bundled(PAGE_SOURCE, "iife")
    return _bundled(MODULES[name], "esm")


def _bundled(source: str, form: str) -> str:
    script = Path(__file__).with_suffix(".mjs")
    command = ["node", str(script), str(NODE_MODULES), str(WEB / source), form]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout


def _page(source: str, script: str) -> str:
    """The page of the bundle: its own script inline, and preloads for the first modules."""
    assert source.count(_SCRIPTS) == source.count(_HEAD_END) == 1
    first = [name for name in MODULES if name not in LATER]
    loads = "".join(f'    <link rel="modulepreload" href="./{name}" />\n' for name in first)
    scripts = f'    <script>{script.strip()}</script>\n    <script type="module" src="./player.js"'
    page = source.replace(_SCRIPTS, f"{scripts}></script>\n")
    return page.replace(_HEAD_END, loads + _HEAD_END)


def main() -> None:
    folder = WEB / "bundle"
    folder.mkdir(exist_ok=True)
    files = {name: built(name) for name in NAMES}
    for path in folder.iterdir():
        if path.name not in files:
            path.unlink()
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
