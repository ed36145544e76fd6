"""Status reports of clients over real sockets, and their effect on plays."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from server.abr.clientstatus import PLAY_HEADER, ClientStatus
from server.abr.session import PlaySession
from server.operate.overload import Overload, OverloadConfig
from server.operate.workers import make_token
from tests.support.server.running_server import eventually, make_stream, served

pytestmark = pytest.mark.anyio


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("root")
    make_stream(folder / "walk", 23, fps=300)
    make_stream(folder / "long", 240, fps=20)
    return folder


NONSENSE = (b"", b"[]", b"{}", b'{"frame": -1}', b'{"frame": 1, "busy": 2}', b"\xff")


async def test_a_status_report_is_accepted_or_refused_in_one_line(
    root: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async with served(root) as (server, client):
        reports = server.state.metrics.status_reports

        async def post(url: str, body: bytes, **headers: str) -> tuple[int, str]:
            async with client.post(url, data=body, headers=headers) as response:
                text = await response.text()
                assert response.headers["Cache-Control"] == "no-store"
                return response.status, text

        async with client.get("/v1/streams/long/play?layers=1") as response:
            token = response.headers[PLAY_HEADER]
            assert len(token) >= 22  # 128 bits
            assert PLAY_HEADER in response.headers["Access-Control-Expose-Headers"]
            assert response.headers["X-Accel-Buffering"] == "no"  # nginx passes it on at once
            url = f"/v1/streams/long/play/{token}"
            assert await post(url, ClientStatus(1, 0.5, paused=True).to_json()) == (204, "")
            assert await post(url, b'{"buffer_s": 2}') == (204, "")
            assert reports.value("taken") + reports.value("replaced") == 2
            for body in NONSENSE:
                status, text = await post(url, body)
                assert status == 400, body
                assert text.startswith('{"error": "client status of a play: '), text
                assert "\n" not in text
            assert (await post(url, b" " * 1024))[0] == 400
            assert (await post(url, b" " * 1025))[0] == 413
            status, text = await post(url, b"not gzip", **{"Content-Encoding": "gzip"})
            assert status == 400, text
            assert reports.value("refused") == len(NONSENSE) + 2
            for other in (f"/v1/streams/walk/play/{token}", f"{url}x"):
                status, text = await post(other, b'{"frame": 1}')
                assert status == 404
                assert "no such play" in text
            assert reports.value("unknown") == 2
            assert (await post(f"/v1/streams/long/play/{'a' * 65}", b"{}"))[0] == 404
            async with client.get(url) as wrong:
                assert wrong.status == 405
            async with client.options(url) as may:
                assert "POST" in may.headers["Access-Control-Allow-Methods"]
                assert PLAY_HEADER in may.headers["Access-Control-Allow-Headers"]
            response.close()
        await eventually(lambda: not len(server.state.plays))
        assert (await post(url, b'{"frame": 1}'))[0] == 404
    assert not caplog.records


class Full(Overload):
    """Has room only for a client that continues a play."""

    def accepts_plays(self, num_plays: int, continues: bool = False) -> bool:
        return continues


async def test_under_load_a_token_continues_one_play_once(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("server.answers.statusreport.END_S", 0.0)
    url = "/v1/streams/long/play?layers=4"
    async with served(root) as (server, client):
        state = server.state

        async def play(last: str) -> int:
            async with client.get(url, headers={PLAY_HEADER: last}) as again:
                again.close()
                return again.status

        async with client.get(url) as response:
            token = response.headers[PLAY_HEADER]
            state.overload = Full(OverloadConfig(), 512)
            assert [await play(last) for last in (token, f"{token[:-1]}-", "")] == [503] * 3
            async with client.get(url, headers={"Accept": "text/html"}) as shown:
                assert (shown.status, "server is busy" in await shown.text()) == (503, True)
                assert int(shown.headers["Retry-After"]) > 0
            response.close()
        await eventually(lambda: not len(state.plays))
        assert [await play(token) for _ in range(3)] == [200, 503, 503]
        # One that the worker before this one had issued, which died.
        state.began_s += 10
        lost = make_token(state.number, state.play_secret, state.began_s - 5)
        assert [await play(lost) for _ in range(2)] == [200, 503]


async def test_a_client_that_comes_back_does_not_start_blind(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    known: list[float | None] = []

    class Noting(PlaySession):
        def __init__(self, *values: Any, **named: Any) -> None:
            known.append(values[6])
            super().__init__(*values, **named)

    monkeypatch.setattr("server.answers.play.PlaySession", Noting)

    async with served(root) as (server, client):

        async def play(last: str) -> str:
            url = "/v1/streams/walk/play?layers=4"
            async with client.get(url, headers={PLAY_HEADER: last}) as response:
                await response.read()
                return response.headers[PLAY_HEADER]

        plays = server.state.plays
        first = await play("")
        await eventually(lambda: not len(plays))
        plays.begin(first, "walk").rate_bps = 5e6  # replaces the measured rate
        plays.end(first, asyncio.get_running_loop().time())
        second = await play(first)
        assert second != first
        await play("never-given")
        assert known == [None, 5e6, None]
        await eventually(lambda: not len(plays))
        plays.begin(second, "walk").rate_bps = 6e6
        await play(second)  # a seek: the old play keeps running
        assert known[-1] == 6e6
        plays.end(second, 0.0)
