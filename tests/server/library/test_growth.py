"""Waiting for a live stream: ends at once when it grows, bounded otherwise, cheap for many."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import pytest

from server.library import Library
from server.library.servedstream import Growth
from tests.support.server.running_server import (
    SEGMENT_FRAMES,
    append_frames,
    live_stream,
    make_stream,
)
from tests.support.server.virtualtime import now_s, passes, virtually


@asynccontextmanager
async def watched(root: Path, refresh_s: float = 3600.0) -> AsyncIterator[Library]:
    """A library that, by default, looks only for waiting clients."""
    library = Library(root, refresh_s)
    watch = asyncio.create_task(library.watch())
    await passes(0.05)
    try:
        yield library
    finally:
        watch.cancel()
        with suppress(asyncio.CancelledError):
            await watch


def test_waiting_ends_in_time_and_may_be_cancelled(tmp_path: Path) -> None:
    writer = live_stream(tmp_path / "live")

    async def check() -> None:
        async with watched(tmp_path) as library:
            stream = library.streams["live"]
            count, began_s = stream.view.num_segments, now_s()
            await stream.wait_for_growth(count, 0.2)
            assert now_s() - began_s == pytest.approx(0.2)
            long, short, cancelled = (
                asyncio.create_task(stream.wait_for_growth(count, seconds))
                for seconds in (30.0, 0.1, 30.0)
            )
            await short
            cancelled.cancel()
            with pytest.raises(asyncio.CancelledError):
                await cancelled
            append_frames(writer)
            await long
            assert now_s() - began_s < 0.5
            await passes(0.1)
            # No client waits: only this task and the watch run.
            assert len(asyncio.all_tasks()) == 2

    virtually(check())
    # The same on another loop.
    virtually(check())


@pytest.mark.parametrize("how", ["deleted", "replaced", "broken"])
def test_who_waits_for_a_stream_that_goes_is_told(tmp_path: Path, how: str) -> None:
    live_stream(tmp_path / "root" / "live", 2 * SEGMENT_FRAMES)
    path = tmp_path / "root" / "live"
    other = make_stream(tmp_path / "other", 3)

    async def check() -> None:
        async with watched(tmp_path / "root", 0.1) as library:
            stream = library.streams["live"]
            waiter = asyncio.create_task(stream.wait_for_growth(2, 30.0))
            await passes(0.1)
            if how == "broken":
                (path / "manifest.json").write_text("{")
            else:
                shutil.rmtree(path)
                if how == "replaced":
                    shutil.copytree(other, path)
            await waiter
            assert now_s() < 1.0
            assert stream.gone
            assert library.streams.get("live") is not stream

    virtually(check())


def test_however_many_wait_one_looks() -> None:
    looks = 0

    async def look() -> None:
        nonlocal looks
        looks += 1

    async def check() -> None:
        growth, over = Growth(look), False
        waiters = [asyncio.create_task(growth.wait(lambda: over, 10.0)) for _ in range(1000)]
        await passes(0.5)
        assert growth.num_waiting == 1000
        assert 10 <= looks <= 11
        growth.wake()  # for another reason
        await passes(0)
        over = True
        growth.wake()
        await asyncio.gather(*waiters)
        assert growth.num_waiting == 0
        before = looks
        await passes(0.1)
        assert looks == before

    virtually(check())
