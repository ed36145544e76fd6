"""The objects of a stream's sound over HTTP: those that its manifest names, and no others."""

from __future__ import annotations

import wave
from pathlib import Path

import aiohttp
import numpy as np

from codec.stream.sound import SAMPLE_RATE, SoundSource
from codec.tools.streamsound import add_sound
from tests.support.server.running_server import Running, make_stream, on_server


def test_they_are_served_like_the_other_files(tmp_path: Path) -> None:
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

    async def check(server: Running, client: aiohttp.ClientSession) -> None:
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

    on_server(tmp_path / "root", check)
