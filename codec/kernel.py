"""The compiler of inner loops."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit


def kernel(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`njit(**options)`, kept on disk where there is a place for that."""

    def compiled(function: Callable[..., Any]) -> Any:
        try:
            return njit(cache=True, **options)(function)
        except RuntimeError:
            # Numba refuses, at import, where neither the package's folder nor the user's cache can
            # be written. Each process then compiles anew, which beats a server that cannot start.
            return njit(**options)(function)

    return compiled
