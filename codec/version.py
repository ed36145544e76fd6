"""The version of swings."""

from __future__ import annotations

from importlib import metadata
from typing import Any


def version() -> str:
    """The version of the installed project, such as 0.1.0; "unknown" beside a source tree that is
    not installed."""
    try:
        return metadata.version("swings")
    except metadata.PackageNotFoundError:
        return "unknown"


def __getattr__(name: str) -> Any:
    """`__version__` of the packages, which take this function in: asked for seldom, and looked up
    in files."""
    if name == "__version__":
        return version()
    raise AttributeError(f"swings has no attribute {name!r}")
