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
from tests.support.server.running_server import fetch, make_stream, served

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
    sound = (path / "segments" / "0" / "audio-main").read_bytes()
    (path / "segments" / "0" / "audio-other").write_bytes(sound)
    broken = make_stream(tmp_path / "root" / "broken", 3)
    add_sound(broken, tmp_path / "in.wav", SoundSource("main", 2))
    (broken / "segments" / "0" / "audio-main").write_bytes(sound[:-1])

    async with served(tmp_path / "root") as (server, client):
        url = "/v1/streams/walk/segments/0/audio-main"
        found = await fetch(client, url)
        assert (found.status, found.body) == (200, sound)
        assert found.headers["Cache-Control"] == "no-cache"
        assert (await fetch(client, url, If_None_Match=found.headers["ETag"])).status == 304
        for name in ("0/audio-other", "0/audio-", "0/audio-Main", "999/audio-main"):
            assert (await fetch(client, f"/v1/streams/walk/segments/{name}")).status == 404
        damaged = await fetch(client, "/v1/streams/broken/segments/0/audio-main")
        assert damaged.status == 500
        with monkeypatch.context() as patch:
            patch.setattr(ServedStream, "read_sound", None)  # cached objects are not read again
            assert (await fetch(client, url)).body == sound
        add_sound(broken, tmp_path / "in.wav", SoundSource("other", 1))
        other = (broken / "segments" / "0" / "audio-other").read_bytes()
        assert other != sound
        write_atomic(path / "segments" / "0" / "audio-main", other)
        assert (await fetch(client, url)).body == other
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
