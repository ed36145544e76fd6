"""The log on real pipes and files, with readers that are slow, gone or killed with it."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from server.operate.log import eventlog
from server.operate.log.eventlog import EventLog
from server.operate.log.logline import LogStyle
from tests.support.commands import ROOT
from tests.support.waiting import BOUND_S, wait_until

START = (
    "import sys\n"
    "from server.operate.log import eventlog\n"
    "from server.operate.log.logline import LogStyle\n"
    "log = eventlog.EventLog(1, LogStyle.JSON)\n"
)


def json_log(descriptor: int, **options: Any) -> EventLog:
    return EventLog(descriptor, LogStyle.JSON, **options)


def read_until_closed(descriptor: int) -> list[dict[str, Any]]:
    with os.fdopen(descriptor, "rb") as file:
        return [json.loads(line) for line in file.read().splitlines()]


def numbers(lines: list[dict[str, Any]]) -> list[int]:
    return [line["n"] for line in lines if line["event"] == "x"]


def test_a_sink_that_is_stuck_holds_nobody_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(eventlog, "CLOSE_S", BOUND_S)
    reader, descriptor = os.pipe()
    log = json_log(descriptor, max_lines=2000)
    with log:
        for n in range(10_000):  # nobody reads: a call that waits waits for ever
            log.event("x", n=n)
        assert 5_000 < log.num_dropped < 10_000
        # The reader wakes up: the queued lines are complete, then comes the number of dropped ones.
        read: list[list[dict[str, Any]]] = []
        thread = threading.Thread(target=lambda: read.append(read_until_closed(reader)))
        thread.start()
        last = 10_000

        def is_kept() -> bool:
            nonlocal last
            before, last = log.num_dropped, last + 1
            log.event("x", n=last - 1)
            return log.num_dropped == before

        wait_until(is_kept)
    os.close(descriptor)
    thread.join(BOUND_S)
    kept = numbers(read[0])
    assert kept == sorted(kept)
    assert len(kept) + log.num_dropped == last
    assert kept[-1] == last - 1
    told = [line["lines"] for line in read[0] if line["event"] == "log_dropped"]
    assert sum(told) == log.num_dropped


def test_what_a_full_disk_dropped_is_reported_once_it_has_room(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, write = tmp_path / "log", os.write

    def full(descriptor: int, data: bytes) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    with path.open("ab") as file:
        log = json_log(file.fileno())
        monkeypatch.setattr(os, "write", full)
        for n in range(3):
            log.event("x", n=n)
        monkeypatch.setattr(os, "write", write)
        for n in range(3, 5):
            log.event("x", n=n)
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    told = [(line["level"], line["event"], line.get("lines")) for line in lines]
    assert told == [("info", "x", None), ("warning", "log_dropped", 3), ("info", "x", None)]
    assert log.num_dropped == 3


def test_a_sink_that_is_stuck_at_the_end_does_not_keep_the_process() -> None:
    reader, descriptor = os.pipe()
    code = START + "log.__enter__()\nfor n in range(20_000): log.event('x', n=n)\n"
    process = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT, stdout=descriptor)
    os.close(descriptor)
    assert process.wait(timeout=BOUND_S) == 0
    os.close(reader)
