"""An event loop whose time passes at once: it jumps to the next timer when nothing is ready."""

from __future__ import annotations

import asyncio
import selectors
from collections.abc import Callable, Coroutine
from functools import wraps
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")


class _Selector(selectors.DefaultSelector):
    """Never waits; counts instead the seconds that it was asked to wait."""

    now_s = 0.0

    def select(self, timeout: float | None = None) -> list[Any]:
        found = super().select(0)
        if not found:
            assert timeout is not None, "no timer, and nothing to wait for: this would never end"
            self.now_s += max(0.0, timeout)
        return found


class VirtualLoop(asyncio.SelectorEventLoop):
    """For what needs no network: bytes on the way between two sockets take no virtual time. What
    would run in a thread runs at once."""

    def __init__(self) -> None:
        self.selector = _Selector()
        super().__init__(self.selector)

    def time(self) -> float:
        return self.selector.now_s

    def run_in_executor(  # type: ignore[override]
        self, executor: object, func: Callable[..., T], *arguments: Any
    ) -> asyncio.Future[T]:
        future: asyncio.Future[T] = self.create_future()
        try:
            future.set_result(func(*arguments))
        except Exception as error:
            future.set_exception(error)
        return future


def virtually(task: Coroutine[Any, Any, T]) -> T:
    """Runs `task` on a loop of its own."""
    with asyncio.Runner(loop_factory=VirtualLoop) as runner:
        return runner.run(task)


def in_virtual_time(test: Callable[P, Coroutine[Any, Any, None]]) -> Callable[P, None]:
    """A test that is a coroutine, for pytest."""

    @wraps(test)
    def run(*arguments: P.args, **named: P.kwargs) -> None:
        virtually(test(*arguments, **named))

    return run


def hold_up(seconds: float) -> None:
    """Lets the time of the running loop pass while nothing runs on it."""
    loop = asyncio.get_running_loop()
    assert isinstance(loop, VirtualLoop)
    loop.selector.now_s += seconds


def now_s() -> float:
    """Seconds since the loop began."""
    return asyncio.get_running_loop().time()


async def passes(seconds: float) -> None:
    """Waits for `seconds` of the loop's time."""
    await asyncio.sleep(seconds)  # sleeps: virtual seconds
