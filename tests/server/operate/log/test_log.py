"""One log: its lines, events and records, on real pipes and files, with slow or absent readers."""

from __future__ import annotations

import errno
import json
import logging
import os
import select
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
from server.operate.log import eventlog
from server.operate.log.eventlog import EventLog
from server.operate.log.logline import MAX_LINE_BYTES, LineFormatter, LogStyle, Value
from tests.support.commands import ROOT
from tests.support.waiting import BOUND_S, wait_until

FORMATTERS = JSON, PLAIN = LineFormatter(LogStyle.JSON), LineFormatter(LogStyle.PLAIN)


def line(formatter: LineFormatter, event: str, **fields: Value) -> str:
    return formatter.line(1_800_000_000.25, "info", event, fields)


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
        assert len(text) <= MAX_LINE_BYTES
    told = json.loads(line(JSON, "request", **fields))
    for key, value in fields.items():
        if isinstance(value, int) or (isinstance(value, str) and len(value) <= 48):
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
    # Characters of six bytes each: more is cut off, so that a pipe accepts the line in one piece.
    told = json.loads(line(JSON, "x", path="\x01" * 9000, traceback="\x01" * 9000))
    assert (len(told["path"]), len(told["traceback"])) == (48, 384)


class Told:
    """A log that writes into a file."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self.log = EventLog(file.fileno(), LogStyle.JSON)

    def lines(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in Path(self._file.name).read_text().splitlines()]


@pytest.fixture
def told(tmp_path: Path) -> Iterator[Told]:
    with (tmp_path / "log").open("ab") as file:
        yield Told(file)


@pytest.fixture
def logger(told: Told) -> logging.Logger:
    logger = logging.Logger("server.test")
    logger.addHandler(told.log)
    return logger


def warning(message: str, created_s: float = 0.0) -> logging.LogRecord:
    fields = {"name": "x", "msg": message, "levelno": logging.WARNING, "levelname": "WARNING"}
    return logging.makeLogRecord(fields | {"created": created_s})


def test_the_same_warning_is_logged_once_a_minute_with_its_count(told: Told) -> None:
    for created_s in [*[0.0] * 1000, 61.0]:
        told.log.handle(warning("descriptors are out", created_s))
    told.log.handle(warning("another", 61.0))
    assert [(line["message"], line.get("held_back")) for line in told.lines()] == [
        ("descriptors are out", None),
        ("descriptors are out", 999),
        ("another", None),
    ]


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
    assert (told.lines(), told.log.num_dropped) == ([], 2)
    for _ in range(2):
        told.log.event("request", path="x")
    assert sorted((line["event"], line.get("lines", 0)) for line in told.lines()) == [
        ("log_dropped", 2),
        *[("request", 0)] * 2,
    ]
    assert capsys.readouterr().err == ""


def test_a_sink_that_is_stuck_holds_nobody_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(eventlog, "CLOSE_S", BOUND_S)
    sizes, write = list[int](), os.write

    def noting(descriptor: int, data: bytes) -> int:
        sizes.append(len(data))
        return write(descriptor, data)

    monkeypatch.setattr(os, "write", noting)
    reader, descriptor = os.pipe()
    log, last = EventLog(descriptor, LogStyle.JSON, max_lines=2000), 10_000
    with log, open(reader, "rb") as file, ThreadPoolExecutor(1) as pool:
        for n in range(last):  # nobody reads: a call that waits waits for ever
            log.event("x", n=n)
        assert 5_000 < log.num_dropped < last
        # The reader wakes up: the queued lines are complete, then comes the number of dropped ones.
        reading = pool.submit(file.readlines)

        def is_kept() -> bool:
            nonlocal last
            before, last = log.num_dropped, last + 1
            log.event("x", n=last - 1)
            return log.num_dropped == before

        wait_until(is_kept)
        log.__exit__(None, None, None)
        os.close(descriptor)
        lines = [json.loads(line) for line in reading.result(BOUND_S)]
    kept = [line["n"] for line in lines if line["event"] == "x"]
    assert max(sizes) <= select.PIPE_BUF  # so that processes which share a pipe tear no line
    assert kept == sorted(kept)
    assert len(kept) + log.num_dropped == last
    assert kept[-1] == last - 1
    assert sum(line.get("lines", 0) for line in lines) == log.num_dropped


def test_a_sink_that_is_stuck_at_the_end_does_not_keep_the_process() -> None:
    code = (
        "from server.operate.log.eventlog import EventLog\n"
        "from server.operate.log.logline import LogStyle\n"
        "log = EventLog(1, LogStyle.JSON)\n"
        "log.__enter__()\n"
        "for n in range(20_000): log.event('x', n=n)\n"
    )
    reader, descriptor = os.pipe()
    process = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT, stdout=descriptor)
    os.close(descriptor)
    assert process.wait(timeout=BOUND_S) == 0
    os.close(reader)
