"""Playing a stream: from a folder, a server or a static host to a window or to files.

In a script or a notebook: `from player import Scene`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .openscene import Scene

__all__ = ["Scene"]


def __getattr__(name: str) -> Any:
    # What decodes and draws loads slowly, and most who import something from here need none of it.
    if name != "Scene":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from .openscene import Scene

    return Scene
