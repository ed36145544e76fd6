"""The log on real pipes and files, with readers that are slow, gone or killed with it."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from server.operate.log.eventlog import EventLog
from server.operate.log.logline import LogStyle
from tests.support.commands import ROOT
from tests.support.waiting import wait_until

pytestmark = pytest.mark.realtime

START = (
    "import sys\n"
    "from server.operate.log.eventlog import EventLog\n"
    "from server.operate.log.logline import LogStyle\n"
    "log = EventLog(1, LogStyle.JSON)\n"
)


def json_log(descriptor: int, **options: Any) -> EventLog:
    return EventLog(descriptor, LogStyle.JSON, **options)


def read_until_closed(descriptor: int) -> list[dict[str, Any]]:
    with os.fdopen(descriptor, "rb") as file:
        return [json.loads(line) for line in file.read().splitlines()]


def numbers(lines: list[dict[str, Any]]) -> list[int]:
    return [line["n"] for line in lines if line["event"] == "x"]


def test_lines_come_in_order_and_without_an_end(tmp_path: Path) -> None:
    path = tmp_path / "log"
    with path.open("ab") as file, json_log(file.fileno()) as log:
        for n in range(1000):
            log.event("x", n=n)
        wait_until(lambda: path.read_bytes().count(b"\n") == 1000, 10)
    with path.open("rb") as read:
        assert numbers([json.loads(line) for line in read]) == list(range(1000))


def test_a_sink_that_is_stuck_holds_nobody_up() -> None:
    reader, descriptor = os.pipe()
    log = json_log(descriptor, max_lines=2000)
    with log:
        longest_s = 0.0
        for n in range(10_000):
            began_s = time.perf_counter()
            log.event("x", n=n)
            longest_s = max(longest_s, time.perf_counter() - began_s)
        assert longest_s < 0.2
        assert 5_000 < log.num_dropped < 10_000
        # The reader wakes up: the queued lines are complete, then comes the number of dropped ones.
        read: list[list[dict[str, Any]]] = []
        thread = threading.Thread(target=lambda: read.append(read_until_closed(reader)))
        thread.start()
        time.sleep(0.3)
        log.event("x", n=10_000)
    os.close(descriptor)
    thread.join(10)
    kept = numbers(read[0])
    assert kept == sorted(kept)
    assert len(kept) + log.num_dropped == 10_001
    assert kept[-1] == 10_000
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


def test_a_reader_that_has_gone_is_not_an_error() -> None:
    reader, descriptor = os.pipe()
    os.close(reader)
    with json_log(descriptor) as log:
        for n in range(10):
            log.event("x", n=n)
    os.close(descriptor)
    assert log.num_dropped == 10


def test_a_sink_that_is_stuck_at_the_end_does_not_keep_the_process() -> None:
    reader, descriptor = os.pipe()
    code = START + "log.__enter__()\nfor n in range(20_000): log.event('x', n=n)\n"
    process = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT, stdout=descriptor)
    os.close(descriptor)
    assert process.wait(timeout=30) == 0
    os.close(reader)


def test_lines_that_wait_are_written_when_the_process_ends_by_an_exception() -> None:
    code = START + "log.__enter__()\nlog.event('waits')\nraise ValueError\n"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True)
    assert done.returncode == 1
    assert json.loads(done.stdout)["event"] == "waits"


def test_processes_that_share_a_pipe_do_not_tear_each_others_lines() -> None:
    code = START + (
        "import time\n"
        "with log:\n"
        "    for n in range(5_000):\n"
        "        log.event('x', n=n, traceback=sys.argv[1] * (n % 4000))\n"
        "        if n % 100 == 0: time.sleep(0.01)\n"
    )
    reader, descriptor = os.pipe()
    processes = [
        subprocess.Popen([sys.executable, "-c", code, word], cwd=ROOT, stdout=descriptor)
        for word in "abc"
    ]
    os.close(descriptor)
    lines = [line for line in read_until_closed(reader) if line["event"] == "x"]
    assert [process.wait(timeout=30) for process in processes] == [0, 0, 0]
    for word in "abc":
        texts = [line["traceback"] for line in lines if line["traceback"].endswith(word)]
        assert len(texts) > 1000
        assert all(set(text.removeprefix("...")) == {word} for text in texts)
