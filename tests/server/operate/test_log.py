"""One log: its lines, events and records, on real pipes and files, with slow or absent readers."""

from __future__ import annotations

import errno
import json
import logging
import os
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import IO, Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import CorruptError
from server.operate import log
from server.operate.log import MAX_CHARS, EventLog, LineFormatter, LogStyle, Value
from tests.support.commands import ROOT
from tests.support.waiting import BOUND_S, wait_until

FORMATTERS = JSON, PLAIN = LineFormatter(LogStyle.JSON), LineFormatter(LogStyle.PLAIN)


def line(formatter: LineFormatter, event: str, **fields: Value) -> str:
    told = {"created": 1_800_000_000.25, "levelname": "INFO", "event": event, "fields": fields}
    return formatter.format(logging.makeLogRecord(told))


def test_a_request_is_one_line_of_either_style() -> None:
    fields: dict[str, Value] = {"path": "/v1/a b", "status": 200, "seconds": 0.12345678, "x": None}
    assert line(PLAIN, "request", **fields, kept=True) == (
        '2027-01-15T08:00:00.250Z info request path="/v1/a b" status=200 seconds=0.123457 kept=true'
    )
    assert line(JSON, "request", **fields, kept=True) == (
        '{"time":"2027-01-15T08:00:00.250Z","level":"info","event":"request","path":"/v1/a b",'
        '"status":200,"seconds":0.123457,"kept":true}'
    )
    assert json.loads(line(JSON, "ready"))["event"] == "ready"
    assert line(PLAIN, "ready").endswith("Z info ready")


values = st.one_of(
    st.text(st.characters(), max_size=700),
    st.text(st.sampled_from('\n\r\x1b\x7f\x85\u2028\ud800 ="\\a'), max_size=40),
    st.integers(),
    st.floats(),
    st.booleans(),
    st.none(),
)
fields = st.dictionaries(st.sampled_from(["path", "traceback", "status", "note"]), values)


@given(fields)
def test_whatever_a_field_holds_the_line_is_one_and_printable(fields: dict[str, Value]) -> None:
    for formatter in FORMATTERS:
        text = line(formatter, "request", **fields)
        assert all(0x20 <= ord(one) < 0x7F for one in text)
    told = json.loads(line(JSON, "request", **fields))
    for key, value in fields.items():
        if isinstance(value, int) or (isinstance(value, str) and len(value) <= MAX_CHARS):
            assert told[key] == value


@given(st.text(st.characters(), max_size=60), st.text(max_size=60))
def test_nobody_can_forge_a_key_in_plain_text(path: str, agent: str) -> None:
    """Outside quotes, each = is one of ours."""
    rest = line(PLAIN, "request", path=path, agent=agent).split(" request ", 1)[1]
    found = {}
    while rest:
        key, rest = rest.split("=", 1)
        if rest.startswith('"'):
            found[key], end = json.JSONDecoder().raw_decode(rest)
            rest = rest[end:].removeprefix(" ")
        else:
            found[key], _, rest = rest.partition(" ")
    assert found == {"path": path, "agent": agent}


def test_long_fields_are_cut_at_their_end_and_a_traceback_at_its_beginning() -> None:
    told = json.loads(line(JSON, "x", path="p" * 9000, traceback="t" * 9000 + "KeyError"))
    assert (len(told["path"]), len(told["traceback"])) == (512, 3000)
    assert told["path"].endswith("p...")
    assert told["traceback"].startswith("...t")
    assert told["traceback"].endswith("tKeyError")


class Told:
    """A log that writes into a file."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self.log = EventLog(file.fileno(), LogStyle.JSON)

    def lines(self) -> list[dict[str, Any]]:
        """All lines, after the end of the log."""
        self.log.close()
        return [json.loads(line) for line in Path(self._file.name).read_text().splitlines()]


@pytest.fixture
def told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Told]:
    monkeypatch.setattr(log, "CLOSE_S", BOUND_S)
    with (tmp_path / "log").open("ab") as file:
        told = Told(file)
        with told.log:
            yield told


@pytest.fixture
def logger(told: Told) -> logging.Logger:
    logger = logging.Logger("server.test")
    logger.addHandler(told.log)
    return logger


def test_a_record_is_one_line(told: Told, logger: logging.Logger) -> None:
    logger.info("play of %s: %s", "walk", "complete\nforged")
    (line,) = told.lines()
    assert line.pop("time").endswith("Z")
    assert line == {
        "level": "info",
        "event": "record",
        "logger": "server.test",
        "message": "play of walk: complete\nforged",
    }


def test_a_traceback_comes_with_bugs_only(told: Told, logger: logging.Logger) -> None:
    for error in (CorruptError("byte 3: x"), ConnectionResetError("gone"), KeyError("bug")):
        try:
            raise error
        except Exception:
            logger.exception("%s failed", type(error).__name__)
    expected, gone, bug = told.lines()
    assert expected["error"] == "CorruptError: byte 3: x"
    assert gone["error"] == "ConnectionResetError: gone"
    assert "traceback" not in expected | gone
    assert "KeyError: 'bug'" in bug["traceback"]
    assert "test_log.py" in bug["traceback"]


def test_what_cannot_be_written_is_counted_and_reported_once_it_can(
    told: Told, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(descriptor: int, data: bytes) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    told.log.event("request", path=Path("x"))  # type: ignore[arg-type]
    with monkeypatch.context() as patched:
        patched.setattr(os, "write", full)
        told.log.event("request", path="x")
        told.log.event("request", path="x")
        wait_until(lambda: told.log.num_dropped == 4)  # among them a report of the first
    told.log.event("request", path="x")
    assert [(line["event"], line.get("lines", 0)) for line in told.lines()] == [
        ("log_dropped", 3),
        ("request", 0),
    ]
    assert capsys.readouterr().err == ""


def test_a_sink_that_is_stuck_holds_nobody_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(log, "CLOSE_S", BOUND_S)
    reader, descriptor = os.pipe()
    stuck, last = EventLog(descriptor, LogStyle.JSON, max_lines=2000), 10_000
    with stuck, open(reader, "rb") as file, ThreadPoolExecutor(1) as pool:
        for n in range(last):  # nobody reads: a call that waits waits for ever
            stuck.event("x", n=n)
        assert 5_000 < stuck.num_dropped < last
        # The reader wakes up: the queued lines are complete, then comes the number of dropped ones.
        reading = pool.submit(file.readlines)

        def is_kept() -> bool:
            nonlocal last
            before, last = stuck.num_dropped, last + 1
            stuck.event("x", n=last - 1)
            return stuck.num_dropped == before

        wait_until(is_kept)
        stuck.close()
        os.close(descriptor)
        lines = [json.loads(line) for line in reading.result(BOUND_S)]
    kept = [line["n"] for line in lines if line["event"] == "x"]
    assert kept == sorted(kept)
    assert len(kept) + stuck.num_dropped == last
    assert kept[-1] == last - 1
    assert sum(line.get("lines", 0) for line in lines) == stuck.num_dropped


def test_a_sink_that_is_stuck_at_the_end_does_not_keep_the_process() -> None:
    code = (
        "from server.operate.log import EventLog, LogStyle\n"
        "log = EventLog(1, LogStyle.JSON)\n"
        "log.__enter__()\n"
        "for n in range(20_000): log.event('x', n=n)\n"
    )
    reader, descriptor = os.pipe()
    process = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT, stdout=descriptor)
    os.close(descriptor)
    assert process.wait(timeout=BOUND_S) == 0
    os.close(reader)
