"""Waiting for a live stream: ends at once when it grows, bounded otherwise, cheap for many."""

from __future__ import annotations

import asyncio
import shutil
import sys
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import pytest

from server.library import Library
from server.library.growth import Growth
from tests.support.server.running_server import (
    SEGMENT_FRAMES,
    append_frames,
    live_stream,
    make_stream,
)

pytestmark = pytest.mark.realtime


@asynccontextmanager
async def seldom_watched(root: Path) -> AsyncIterator[Library]:
    """A library that looks only for waiting clients."""
    library = Library(root, 3600.0)
    watch = asyncio.create_task(library.watch())
    await asyncio.sleep(0.05)
    try:
        yield library
    finally:
        watch.cancel()
        with suppress(asyncio.CancelledError):
            await watch


def test_who_waits_is_told_at_once_and_knows_the_new_view(tmp_path: Path) -> None:
    writer = live_stream(tmp_path / "live")

    async def check() -> None:
        async with seldom_watched(tmp_path) as library:
            stream = library.streams["live"]
            for number in range(5):
                waiters = [
                    asyncio.create_task(stream.wait_for_growth(number, 5.0)) for _ in range(50)
                ]
                await asyncio.sleep(0.12)
                assert not any(waiter.done() for waiter in waiters)
                await asyncio.to_thread(append_frames, writer)
                began_s = time.monotonic()
                await asyncio.gather(*waiters)
                late_s = time.monotonic() - began_s
                assert stream.view.num_segments == number + 1
                sys.stdout.write(f"50 waiters knew a segment {1e3 * late_s:.0f} ms after it came\n")
                assert late_s < 1.0
            waiter = asyncio.create_task(stream.wait_for_growth(5, 5.0))
            await asyncio.sleep(0.05)
            writer.close()
            await asyncio.wait_for(waiter, 1.0)
            assert not stream.live
            # The stream will not grow, so the wait ends at once.
            await asyncio.wait_for(stream.wait_for_growth(5, 100.0), 0.5)

    asyncio.run(check())


def test_waiting_ends_in_time_and_may_be_cancelled(tmp_path: Path) -> None:
    writer = live_stream(tmp_path / "live")

    async def check() -> None:
        async with seldom_watched(tmp_path) as library:
            stream = library.streams["live"]
            count = stream.view.num_segments
            began_s = time.monotonic()
            await stream.wait_for_growth(count, 0.2)
            assert 0.19 < time.monotonic() - began_s < 1.0
            long, short = (
                asyncio.create_task(stream.wait_for_growth(count, seconds))
                for seconds in (30.0, 0.1)
            )
            cancelled = asyncio.create_task(stream.wait_for_growth(count, 30.0))
            await short
            cancelled.cancel()
            with pytest.raises(asyncio.CancelledError):
                await cancelled
            append_frames(writer)
            await asyncio.wait_for(long, 1.0)
            await asyncio.sleep(0.1)
            # No client waits: only this task and the watch run.
            assert len(asyncio.all_tasks()) == 2

    asyncio.run(check())
    # The same on another loop.
    asyncio.run(check())


@pytest.mark.parametrize("how", ["deleted", "replaced", "broken"])
def test_who_waits_for_a_stream_that_goes_is_told(tmp_path: Path, how: str) -> None:
    live_stream(tmp_path / "root" / "live", 2 * SEGMENT_FRAMES)
    path = tmp_path / "root" / "live"
    other = make_stream(tmp_path / "other", 3)

    async def check() -> None:
        library = Library(tmp_path / "root", 0.1)
        watch = asyncio.create_task(library.watch())
        stream = library.streams["live"]
        waiter = asyncio.create_task(stream.wait_for_growth(2, 30.0))
        await asyncio.sleep(0.1)
        if how == "broken":
            (path / "manifest.json").write_text("{")
        else:
            shutil.rmtree(path)
            if how == "replaced":
                shutil.copytree(other, path)
        await asyncio.wait_for(waiter, 2.0)
        assert stream.gone
        assert library.find("live") is not stream
        watch.cancel()

    asyncio.run(check())


def test_however_many_wait_one_looks() -> None:
    looks = 0

    async def look() -> None:
        nonlocal looks
        looks += 1

    async def check() -> None:
        growth, over = Growth(look, 0.02), False
        waiters = [asyncio.create_task(growth.wait(lambda: over, 10.0)) for _ in range(1000)]
        await asyncio.sleep(0.5)
        assert growth.num_waiting == 1000
        assert 5 <= looks <= 30
        growth.wake()  # for another reason
        await asyncio.sleep(0)
        over = True
        growth.wake()
        await asyncio.wait_for(asyncio.gather(*waiters), 1.0)
        assert growth.num_waiting == 0
        before = looks
        await asyncio.sleep(0.1)
        assert looks == before

    asyncio.run(check())
