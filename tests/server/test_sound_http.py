"""The objects of a stream's sound over HTTP: only those that its manifest names."""

from __future__ import annotations

import asyncio
import wave
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from codec.files import write_atomic
from codec.storage.storage import Stamp
from codec.stream.sound import SAMPLE_RATE, SoundSource
from codec.tools.streamsound import add_sound
from server.library.servedstream import ServedStream
from server.state.soundcache import SoundCache
from tests.support.server.running_server import make_stream, served

pytestmark = pytest.mark.anyio


async def test_they_are_served_like_the_other_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = make_stream(tmp_path / "root" / "walk", 3)
    with wave.open(str(tmp_path / "in.wav"), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(SAMPLE_RATE)
        tone = 8000 * np.sin(np.arange(9000) / 10)
        file.writeframes(tone.astype("<i2").tobytes())
    add_sound(path, tmp_path / "in.wav", SoundSource("main", 2))
    objects = {n: (path / f"segments/{n}/audio-main").read_bytes() for n in range(1)}
    (path / "segments" / "0" / "audio-other").write_bytes(objects[0])
    broken = make_stream(tmp_path / "root" / "broken", 3)
    add_sound(broken, tmp_path / "in.wav", SoundSource("main", 2))
    (broken / "segments" / "0" / "audio-main").write_bytes(objects[0][:-1])

    async with served(tmp_path / "root") as (server, client):
        url = "/v1/streams/walk/segments/"
        for n, data in objects.items():
            async with client.get(f"{url}{n}/audio-main") as response:
                assert (response.status, await response.read()) == (200, data)
                assert response.headers["Cache-Control"] == "no-cache"
                headers = {"If-None-Match": response.headers["ETag"]}
            async with client.get(f"{url}{n}/audio-main", headers=headers) as response:
                assert response.status == 304
        for name in ("0/audio-other", "0/audio-", "0/audio-Main", "999/audio-main"):
            async with client.get(url + name) as response:
                assert response.status == 404
        async with client.get("/v1/streams/broken/segments/0/audio-main") as response:
            assert response.status == 500

        url = "/v1/streams/walk/segments/0/audio-main"
        with monkeypatch.context() as patch:
            patch.setattr(ServedStream, "read_sound", None)  # cached objects are not read again
            async with client.get(url) as response:
                assert (response.status, await response.read()) == (200, objects[0])
        add_sound(broken, tmp_path / "in.wav", SoundSource("other", 1))
        other = (broken / "segments" / "0" / "audio-other").read_bytes()
        assert other != objects[0]
        write_atomic(path / "segments" / "0" / "audio-main", other)
        async with client.get(url) as response:
            assert (response.status, await response.read()) == (200, other)
        assert server.state.sounds.size_bytes == len(other)


def test_the_cache_drops_the_least_recently_used() -> None:
    class Shelf:
        """A library with objects of 10 bytes."""

        generation = 1
        reads = 0

        def sound_stamp(self, segment: int, name: str) -> Stamp:
            return Stamp(10, (segment,))

        def read_sound(self, segment: int, name: str) -> bytes:
            self.reads += 1
            return bytes([segment]) * 10

    async def check() -> None:
        shelf = Shelf()
        stream, cache = cast(ServedStream, shelf), SoundCache(25)
        for segment, reads in ((0, 1), (1, 2), (0, 2), (2, 3), (0, 3), (1, 4)):
            content = await cache.content(stream, segment, "audio-main")
            assert (content.data, shelf.reads) == (bytes([segment]) * 10, reads)
            assert cache.size_bytes <= 25

    asyncio.run(check())
