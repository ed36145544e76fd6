"""The browser player as it is installed: the files of its bundle, its scripts also under names that
change with the content."""

from __future__ import annotations

import gzip
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import zstandard

from codec.errors import InvalidError

_TYPES = {".js": "text/javascript", ".html": "text/html"}

_BUNDLE = "bundle"


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
        folder = (folder or _installed()) / _BUNDLE
        found = {path.name: path.read_bytes() for path in folder.glob("*") if path.suffix in _TYPES}
        try:
            described = json.loads((folder / "manifest.json").read_bytes())
            first, harmonics = described["first"]["served"], described["harmonics"]
            self.page_script = found["page.js"].decode().strip()
            """The script that a page with the player has inline."""
            if not all(found[name] for name in (*first, harmonics)):
                raise KeyError("an empty script")
        except (OSError, KeyError, ValueError) as error:
            message = f"{folder} does not hold the browser player; reinstall swings"
            raise InvalidError(message) from error
        scripts = [name for name in sorted(found) if name.endswith(".js")]
        # One hash for all of them: they name each other by relative URLs.
        together = b"".join(found[name] for name in scripts)
        version = f"{_BUNDLE}-{hashlib.sha256(together).hexdigest()[:16]}"
        self.modules = tuple(f"{version}/{name}" for name in first)
        """Names of the modules that a page begins with; the first one is the element."""
        self.harmonics = f"{version}/{harmonics}"
        """The module that a stream with harmonics of degree 2 or 3 needs, too."""
        self.assets: Mapping[str, Asset] = {
            f"{_BUNDLE}/{name}": _asset(name, data) for name, data in found.items()
        } | {f"{version}/{name}": _asset(name, found[name], immutable=True) for name in scripts}


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
