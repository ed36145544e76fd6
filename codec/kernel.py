"""The only place that calls the compiler of inner loops, numba."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit
from numba.core.dispatcher import Dispatcher

Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(**options: Any) -> Callable[[Function], Dispatcher[Function]]:
    """`njit(**options)` that keeps what it compiles on disk, where there is a place for that."""

    def compiled(function: Function) -> Dispatcher[Function]:
        made: Dispatcher[Function]
        try:
            made = njit(cache=True, **options)(function)
        except RuntimeError:
            # Numba refuses where neither the package's folder nor the user's cache can be written.
            # It does so when a module is imported, which would end the program. Compiling anew in
            # each process is slow, but it works.
            made = njit(**options)(function)
        return made

    return compiled
