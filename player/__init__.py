"""Playing a stream: from a folder, a server or a static host to a window or to files.

In a script or a notebook: `from player import Scene`, and `ViserView` to see one in viser.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .script.openscene import Scene
    from .script.viserview import ViserView

__all__ = ["Scene", "ViserView"]


def __dir__() -> list[str]:
    # Otherwise completion knows only what has been used.
    return sorted([*globals(), *__all__])


_MODULES = {"Scene": "player.script.openscene", "ViserView": "player.script.viserview"}


def __getattr__(name: str) -> Any:
    # The code that decodes and draws loads slowly, and most importers of this package need none.
    if name == "__version__":
        from codec.version import version

        return version()
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)
