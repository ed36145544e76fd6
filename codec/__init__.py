"""Slices of Gaussians to bytes and back: the vocabulary and the stream format of swings.

In a script or a notebook: `codec.open_stream("my-stream").frame(12)`; what goes wrong is a
`codec.SwingsError`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .errors import SwingsError
    from .tools.openedstream import OpenedStream, open_stream

__all__ = ["OpenedStream", "SwingsError", "open_stream"]


def __dir__() -> list[str]:
    # Otherwise completion knows only what has been used.
    return sorted([*globals(), *__all__])


def __getattr__(name: str) -> Any:
    # Most importers need no decoder, which loads slowly.
    if name == "SwingsError":
        from . import errors

        return errors.SwingsError
    if name in ("OpenedStream", "open_stream"):
        from .tools import openedstream

        return getattr(openedstream, name)
    if name == "__version__":
        from .version import version

        return version()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
