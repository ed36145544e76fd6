"""The only place that calls the compiler of inner loops, numba."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable
from types import CodeType
from typing import Any, TypeVar

import numpy as np
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
        else:
            if isinstance(made, Dispatcher):  # NUMBA_DISABLE_JIT gives the function as it is
                _notice_what_is_borrowed(made)
        return made

    return compiled


def _notice_what_is_borrowed(made: Any) -> None:
    """Makes what is kept of a kernel out of date when another file changes that it draws on.

    Numba looks at the kernel's own file only. It would go on using old code of a kernel that is
    compiled into this one, or an old value of a constant.
    """
    kept = made._cache._cache_file
    kept._source_stamp = (kept._source_stamp, _fingerprint(made.py_func))


def _fingerprint(function: Callable[..., Any]) -> str:
    """Of a kernel's code, and of all kernels and constants that it uses, however far."""
    code = function.__code__
    values = [value for value in code.co_consts if not isinstance(value, CodeType)]
    parts = [code.co_code.hex(), repr(values), repr(code.co_names)]
    for name in code.co_names:
        used = function.__globals__.get(name)
        if isinstance(used, Dispatcher):
            parts.append(_fingerprint(used.py_func))
        elif isinstance(used, int | float | str | tuple | np.generic):
            parts.append(repr(used))
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def load_without_blas() -> None:
    """Makes numba ready to run kernels without loading scipy.linalg, which takes 0.1 s.

    Kernels call nothing that needs it. In a process where this was called, numba's `inner` and
    `kron` are loops instead; `dot` still finds scipy when it is compiled.
    """
    from numba.np import linalg

    if "numba.np.arraymath" in sys.modules:
        return
    ensure_blas = linalg.ensure_blas
    linalg.ensure_blas = _no_blas
    try:
        import numba.np.arraymath  # noqa: F401
    finally:
        linalg.ensure_blas = ensure_blas


def _no_blas() -> None:
    raise ImportError
