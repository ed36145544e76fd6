"""The only place that calls the compiler of inner loops, numba.

Numba is loaded when a kernel is first run, which takes a quarter of a second and 60 MB: a server
never does.
"""

from __future__ import annotations

import hashlib
import logging
import sys
import threading
from collections.abc import Callable
from functools import update_wrapper
from pathlib import Path
from types import CodeType
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np

if TYPE_CHECKING:
    from numba.core.dispatcher import Dispatcher

log = logging.getLogger(__name__)

Function = TypeVar("Function", bound=Callable[..., Any])

_BUILDING = threading.RLock()


class _Prange:
    """Stands for numba.prange in kernels until one of them is run."""

    def __call__(self, *bounds: int) -> range:
        return range(*bounds)


prange: Any = _Prange()


def kernel(**options: Any) -> Callable[[Function], Dispatcher[Function]]:
    """`njit(**options)` that keeps what it compiles on disk, where there is a place for that."""

    def compiled(function: Function) -> Dispatcher[Function]:
        return cast("Dispatcher[Function]", Kernel(function, options))

    return compiled


class Kernel:
    """A function that numba compiles when it is first called."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        update_wrapper(self, function)
        self._function = function
        self._options = options
        self._made: Any = None

    def __call__(self, *arguments: Any) -> Any:
        return (self._made or self.dispatcher)(*arguments)

    @property
    def dispatcher(self) -> Any:
        """Numba's own; the function as it is where NUMBA_DISABLE_JIT is set."""
        with _BUILDING:
            if self._made is None:
                self._made = self._build()
        return self._made

    def _build(self) -> Any:
        from numba import njit
        from numba import prange as real_prange

        function, names = self._function, self._function.__globals__
        # Numba takes what a kernel calls from where it stands: there it must find its own.
        for name in function.__code__.co_names:
            match names.get(name):
                case Kernel() as used:
                    names[name] = used.dispatcher
                case _Prange():
                    names[name] = real_prange
        made: Any
        try:
            made = njit(cache=True, **self._options)(function)
        except RuntimeError:
            # Numba refuses where neither the package's folder nor the user's cache can be written.
            # Compiling anew in each process is slow, but it works.
            made = njit(**self._options)(function)
        else:
            if hasattr(made, "py_func"):  # NUMBA_DISABLE_JIT gives the function as it is
                _notice_what_is_borrowed(made)
                _do_without_room(made)
        if names.get(function.__name__) is self:
            names[function.__name__] = made
        return made


def _notice_what_is_borrowed(made: Any) -> None:
    """Makes what is kept of a kernel out of date when another file changes that it draws on.

    Numba looks at the kernel's own file only. It would go on using old code of a kernel that is
    compiled into this one, or an old value of a constant.
    """
    kept = made._cache._cache_file
    kept._source_stamp = (kept._source_stamp, _fingerprint(made.py_func))


def _do_without_room(made: Any) -> None:
    """Makes a kernel that cannot be kept, on a full disk for one, run all the same."""
    kept = made._cache._cache_file
    save = kept.save

    def save_where_there_is_room(key: Any, compiled: Any) -> None:
        try:
            save(key, compiled)
        except OSError as error:
            log.info("a compiled kernel cannot be cached: %s", error)
            # The index is written first: it may name what an older source left in the data's place.
            Path(kept._index_path).unlink(missing_ok=True)

    kept.save = save_where_there_is_room


def _fingerprint(function: Callable[..., Any]) -> str:
    """Hash of a kernel's code, and of all kernels and constants that it uses, however far."""
    code = function.__code__
    values = [value for value in code.co_consts if not isinstance(value, CodeType)]
    parts = [code.co_code.hex(), repr(values), repr(code.co_names)]
    for name in code.co_names:
        used: Any = function.__globals__.get(name)
        if hasattr(used, "py_func"):
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
