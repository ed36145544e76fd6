"""Clients of /play that resume, as a process: `python resumeload.py CONFIG_JSON` (ResumeConfig).

Each behaves like a player: it parses the records, shows frames in real time, reports its position
to the server once a second, and after a broken response requests its next slice with the data of
its last play. The arrival times of packets are recorded; `resumefigures` evaluates them.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time
from array import array
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import aiohttp
import numpy as np

from codec.stream.playrecord import (
    EndRecord,
    ErrorRecord,
    KeyframeRecord,
    RecordParser,
    SliceRecord,
)
from player.network.fetch import RetryConfig
from player.source.source import LastPlay
from server.abr.clientstatus import FRAME_HEADER, PLAY_HEADER, RATE_HEADER, ClientStatus, parse_rate

REPORT_S = 1.0
"""Seconds between two status reports."""

FIRST_FRAMES = 15
"""Frames that a client waits for before it shows the first frame."""


@dataclass(frozen=True, slots=True)
class ResumeConfig:
    """The stream, and the number and behaviour of its clients."""

    port: int
    path: str
    """Path of the stream's URL."""
    clients: int
    arrive_s: float
    """Seconds over which the clients arrive, evenly."""
    fps: float
    out: str
    """File for the records, as numpy's npz. The process ends at the end of its stdin."""
    tells_rate: bool = True
    """Whether a returning client sends the link rate that the server last reported to it."""


class ResumeLoad:
    """All clients, and what they received."""

    def __init__(self, config: ResumeConfig) -> None:
        self.config = config
        self.base = f"http://127.0.0.1:{config.port}{config.path}/play"
        # One value per packet.
        self.who, self.birth, self.at_s = array("i"), array("i"), array("d")
        self.first, self.layers = array("b"), array("b")
        # One value per response: time of the request, client, worker, and first slice.
        self.play_s, self.play_who, self.play_place = array("d"), array("i"), array("i")
        self.play_birth = array("i")
        self.stalls = 0
        """Number of times that a client had nothing left to show."""
        self.refused = 0
        """Connections that were not accepted."""
        self.answered: dict[int, int] = {}
        """Number of responses to plays by HTTP status, other than 200; an overloaded server answers
        503."""
        self.said: dict[str, int] = {}
        """Number of responses that ended with an error record, by its message."""
        self.reports: dict[int, int] = {}
        """Number of status reports by HTTP status; 0 for no answer."""
        self.slowest_report_s = 0.0
        self.over_s: dict[int, float] = {}
        """Times at which clients had the whole stream."""

    async def run(self) -> None:
        """Runs the clients until the end of stdin."""
        config = self.config
        timeout = aiohttp.ClientTimeout(total=None, sock_connect=10, sock_read=30)
        # A play gets a connection of its own; reports use any other connection.
        plays = aiohttp.TCPConnector(limit=0, force_close=True)
        async with (
            aiohttp.ClientSession(connector=plays, timeout=timeout) as session,
            aiohttp.ClientSession(timeout=aiohttp.ClientTimeout(total=5)) as teller,
            asyncio.TaskGroup() as group,
        ):
            clients = [_Client(self, number, session, teller) for number in range(config.clients)]
            tasks = [
                group.create_task(one.run(config.arrive_s * n / config.clients))
                for n, one in enumerate(clients)
            ]
            await asyncio.to_thread(sys.stdin.read)
            for task in tasks:
                task.cancel()

    def save(self) -> None:
        known = {
            "stalls": self.stalls,
            "refused": self.refused,
            "answered": self.answered,
            "said": self.said,
        }
        known |= {
            "reports": self.reports,
            "slowest_report_s": self.slowest_report_s,
            "over_s": self.over_s,
        }
        np.savez(
            self.config.out,
            who=np.frombuffer(self.who, np.int32),
            birth=np.frombuffer(self.birth, np.int32),
            at_s=np.frombuffer(self.at_s, np.float64),
            first=np.frombuffer(self.first, np.int8),
            layers=np.frombuffer(self.layers, np.int8),
            play_s=np.frombuffer(self.play_s, np.float64),
            play_who=np.frombuffer(self.play_who, np.int32),
            play_place=np.frombuffer(self.play_place, np.int32),
            play_birth=np.frombuffer(self.play_birth, np.int32),
            known=np.array(json.dumps(known)),
        )


class _Client:
    """One client."""

    def __init__(
        self,
        load: ResumeLoad,
        number: int,
        session: aiohttp.ClientSession,
        teller: aiohttp.ClientSession,
    ) -> None:
        self._load = load
        self._number = number
        self._session = session
        self._teller = teller
        self._next_birth = 0
        self._asked_birth = 0  # earlier slices had arrived before the request
        self._last = LastPlay()
        self._frame = 0.0  # shown next
        self._looked_s: float | None = None  # the time of `_frame`; None before the first picture
        self._over = False
        self._begun = asyncio.Event()  # set when a response begins

    async def run(self, wait_s: float) -> None:
        await asyncio.sleep(wait_s)
        telling = asyncio.create_task(self._tell())
        patience, failures = RetryConfig(), 0
        try:
            while not self._over:
                before = self._next_birth
                try:
                    await self._play()
                except (aiohttp.ClientError, OSError, TimeoutError) as error:
                    self._load.refused += isinstance(error, aiohttp.ClientConnectorError)
                failures = 1 if self._next_birth > before else failures + 1
                delay_s = patience.first_delay_s * 2.0 ** (failures - 1)
                await asyncio.sleep(min(delay_s, patience.max_delay_s))
        finally:
            telling.cancel()

    async def _play(self) -> None:
        """Plays one response to its end."""
        load, number, asked_s = self._load, self._number, time.monotonic()
        frame = self._asked_birth = self._next_birth
        headers = self._last.headers()
        if not load.config.tells_rate:
            headers.pop(RATE_HEADER, None)
        if self._last.token:
            headers[FRAME_HEADER] = str(int(self._frame))
        async with self._session.get(f"{load.base}?from={frame}", headers=headers) as response:
            if response.status != 200:
                load.answered[response.status] = load.answered.get(response.status, 0) + 1
                if response.status == 400:
                    # All slices have arrived: no frame is left to request.
                    self._over = True
                    load.over_s[number] = time.monotonic()
                return
            token = response.headers[PLAY_HEADER]
            self._last = LastPlay(token, self._last.rate_bps)
            load.play_s.append(asked_s)
            load.play_who.append(number)
            load.play_place.append(int(token.partition("-")[0]))
            load.play_birth.append(self._next_birth)
            self._begun.set()
            parser = RecordParser()
            async for piece in response.content.iter_any():
                now_s = time.monotonic()
                for record in parser.feed(piece):
                    if isinstance(record, SliceRecord):
                        self._take(record.birth, record, now_s)
                    elif isinstance(record, KeyframeRecord):
                        self._take(record.frame, record, now_s)
                    elif isinstance(record, ErrorRecord):
                        load.said[record.message] = load.said.get(record.message, 0) + 1
                    elif isinstance(record, EndRecord):
                        self._over = True
                        load.over_s[number] = now_s

    def _take(self, birth: int, record: SliceRecord | KeyframeRecord, now_s: float) -> None:
        """Records a slice, or a keyframe as the slice of its frame. Slices that a play repeats,
        from a keyframe up to the requested frame, are not recorded."""
        if birth < self._asked_birth:
            return
        load = self._load
        load.who.append(self._number)
        load.birth.append(birth)
        load.at_s.append(now_s)
        load.first.append(record.first_layer)
        load.layers.append(len(record.packets))
        if not record.first_layer:
            self._show(now_s)
            self._next_birth = max(self._next_birth, birth + 1)
            if self._looked_s is None and self._next_birth >= FIRST_FRAMES:
                self._looked_s = now_s

    def _show(self, now_s: float) -> None:
        """Shows frames up to the current time, as far as they have arrived."""
        if self._looked_s is None:
            return
        self._frame += (now_s - self._looked_s) * self._load.config.fps
        self._looked_s = now_s
        if self._frame > self._next_birth:
            self._frame = self._next_birth
            self._load.stalls += 1

    async def _tell(self) -> None:
        load = self._load
        while True:
            # Reports the position at once for a new response, and then once a second.
            with suppress(TimeoutError):
                async with asyncio.timeout(REPORT_S):
                    await self._begun.wait()
            self._begun.clear()
            began_s = time.monotonic()
            self._show(began_s)
            if self._last.token:
                status = 0
                try:
                    body = ClientStatus(int(self._frame)).to_json()
                    url = f"{load.base}/{self._last.token}"
                    async with self._teller.post(url, data=body) as answer:
                        status = answer.status
                        rate_bps = parse_rate(answer.headers.get(RATE_HEADER, ""))
                    if rate_bps is not None:
                        self._last = LastPlay(self._last.token, rate_bps)
                except (aiohttp.ClientError, OSError, TimeoutError):
                    pass  # the report is lost; the next one replaces it
                load.reports[status] = load.reports.get(status, 0) + 1
                load.slowest_report_s = max(load.slowest_report_s, time.monotonic() - began_s)


def resume_command(config: ResumeConfig) -> list[str]:
    """The command that runs this file with `config`."""
    return [sys.executable, str(Path(__file__)), json.dumps(asdict(config))]


def main() -> None:
    load = ResumeLoad(ResumeConfig(**json.loads(sys.argv[1])))
    asyncio.run(load.run())
    load.save()


if __name__ == "__main__":
    main()
