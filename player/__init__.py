"""Playing a stream: from a folder, a server or a static host to a window or to files.

In a script or a notebook: `from player import Scene`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .script.openscene import Scene

__all__ = ["Scene"]


def __dir__() -> list[str]:
    # Otherwise completion knows only what has been used.
    return sorted([*globals(), *__all__])


def __getattr__(name: str) -> Any:
    # The code that decodes and draws loads slowly, and most importers of this package need none.
    if name == "__version__":
        from codec.version import version

        return version()
    if name == "Scene":
        from .script.openscene import Scene

        return Scene
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
