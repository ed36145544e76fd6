"""Objects in memory: bounded, read once, and always those of the index."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path

from server.library import Library
from server.operate.prometheus import Metrics
from server.state.objectcache import ObjectCache
from tests.support.server.running_server import make_stream


def test_the_cache_is_bounded_and_reads_once(tmp_path: Path) -> None:
    root = make_stream(tmp_path / "s", 30)
    one_bytes = os.path.getsize(root / "segments" / "1" / "0")

    async def check() -> None:
        stream = Library(root, 1.0).streams["s"]
        metrics = Metrics()
        cache = ObjectCache(3 * one_bytes + 100, metrics)
        loaded = await asyncio.gather(*(cache.load(stream, 1, 0) for _ in range(10)))
        assert all(one is loaded[0] for one in loaded)
        assert metrics.cache_misses.value() == 1
        for segment in range(6):
            found = await cache.load(stream, segment, 0)
            assert found.data == stream.read_object(segment, 0).data
            assert cache.size_bytes <= 3 * one_bytes + 100
        hits = metrics.cache_hits.value()
        await cache.load(stream, 5, 0)
        assert metrics.cache_hits.value() == hits + 1
        # An object that is too large by itself is not cached.
        tiny = ObjectCache(10, Metrics())
        assert (await tiny.load(stream, 0, 0)).data == stream.read_object(0, 0).data
        assert tiny.size_bytes == 0

    asyncio.run(check())
