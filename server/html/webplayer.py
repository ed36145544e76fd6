"""The browser player as it is installed: the files of its bundle, its scripts also under names that
change with the content."""

from __future__ import annotations

import gzip
import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import zstandard

from codec.errors import InvalidError

_TYPES = {".js": "text/javascript", ".html": "text/html"}

_BUNDLE = "bundle/"
_PAGE_SCRIPT = "page.js"
_FIRST = ("player.js", "playworker.js", "sortworker.js")


@dataclass(frozen=True, slots=True)
class Asset:
    """One file."""

    data: bytes
    coded: Mapping[str, bytes]
    """`data` by the content codings in which it can be had, the smallest first."""
    sha256: str
    content_type: str
    immutable: bool = False
    """Whether its name holds a hash of its content."""


class WebPlayer:
    """All files of player/web/bundle, in memory: a request finds one by its name in a table."""

    def __init__(self, folder: Path | None = None) -> None:
        """folder: None for the one that is installed. Raises InvalidError where it is not whole."""
        folder = folder or _installed()
        found = {
            path.relative_to(folder).as_posix(): path.read_bytes()
            for path in sorted((folder / _BUNDLE).glob("*"))
            if path.suffix in _TYPES
        }
        bundle = {
            name.removeprefix(_BUNDLE): data
            for name, data in found.items()
            if name.startswith(_BUNDLE) and name.endswith(".js")
        }
        if not {_PAGE_SCRIPT, *_FIRST} <= bundle.keys():
            raise InvalidError(f"{folder} does not hold the browser player; reinstall swings")
        self.page_script = bundle.pop(_PAGE_SCRIPT).decode().strip()
        """The script that a page with the player has inline."""
        # One hash for all of them: they name each other by relative URLs.
        version = hashlib.sha256(b"".join(bundle.values())).hexdigest()[:16]
        versioned = {name: f"bundle-{version}/{name}" for name in bundle}
        self.modules = tuple(versioned[name] for name in _FIRST)
        """Names of the modules that a page begins with; the first one is the element."""
        self.assets: Mapping[str, Asset] = {
            name: _asset(name, data) for name, data in found.items()
        } | {versioned[name]: _asset(name, bundle[name], immutable=True) for name in bundle}


def _installed() -> Path:
    # By its name: the server does not import the player.
    spec = find_spec("player")
    if spec is None or not spec.submodule_search_locations:
        raise InvalidError("the browser player is not installed; reinstall swings")
    return Path(spec.submodule_search_locations[0]) / "web"


def _asset(name: str, data: bytes, immutable: bool = False) -> Asset:
    sha256 = hashlib.sha256(data).hexdigest()
    # The scripts of the bundle are what viewers wait for; of the rest there is much.
    level = 22 if immutable else 3
    coded = {
        "zstd": zstandard.compress(data, level=level),
        "gzip": gzip.compress(data, mtime=0),
    }
    return Asset(data, coded, sha256, _TYPES[Path(name).suffix], immutable)
