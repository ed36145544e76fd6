"""Events and records of the logging module in one log."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import CorruptError
from server.operate.log.eventlog import EventLog, RecordHandler, Repeats, take_over_logging
from server.operate.log.logline import LogStyle


class Told:
    """A log into a file, with a clock that stands."""

    def __init__(self, path: Path) -> None:
        self.now_s = 1_800_000_000.0
        self._path = path
        self._file = path.open("ab")
        self.log = EventLog(self._file.fileno(), LogStyle.JSON, lambda: self.now_s)

    def lines(self) -> list[dict[str, Any]]:
        return [json.loads(line) for line in self._path.read_text().splitlines()]

    def close(self) -> None:
        self._file.close()


@pytest.fixture
def told(tmp_path: Path) -> Iterator[Told]:
    told = Told(tmp_path / "log")
    yield told
    told.close()


@pytest.fixture
def logger(told: Told) -> logging.Logger:
    logger = logging.Logger("server.test")
    logger.addHandler(RecordHandler(told.log))
    return logger


def test_events_are_lines(told: Told) -> None:
    told.log.event("request", path="/", event_bytes=3)
    told.log.trouble("worker_died", worker=2)
    assert [(line["level"], line["event"]) for line in told.lines()] == [
        ("info", "request"),
        ("error", "worker_died"),
    ]


def test_the_same_event_is_told_once_a_minute_with_its_count(told: Told) -> None:
    for _ in range(1000):
        told.log.repeated("descriptors_out", limit=64)
    told.now_s += 61
    told.log.repeated("descriptors_out", limit=64)
    told.log.repeated("another")
    assert [(line["event"], line.get("held_back")) for line in told.lines()] == [
        ("descriptors_out", None),
        ("descriptors_out", 999),
        ("another", None),
    ]


@given(st.lists(st.tuples(st.sampled_from("abc"), st.floats(0, 30)), max_size=100))
def test_every_event_is_told_or_counted(events: list[tuple[str, float]]) -> None:
    repeats, now_s = Repeats(every_s=60), 0.0
    told: dict[str, list[float]] = {}
    counted: dict[str, int] = {}
    for event, seconds in events:
        now_s += seconds
        held = repeats.tell(event, now_s)
        counted[event] = counted.get(event, 0) + 1
        if held is not None:
            assert held == counted[event] - 1
            counted[event] = 0
            told.setdefault(event, []).append(now_s)
    for times in told.values():
        assert all(b - a >= 60 for a, b in pairwise(times))


def test_many_events_are_not_remembered_for_ever() -> None:
    repeats = Repeats(max_events=3)
    assert [repeats.tell(f"{n}", 0.0) for n in range(100)] == [0] * 100
    assert repeats.tell("99", 0.0) is None
    assert repeats.tell("0", 0.0) == 0


def test_a_record_is_one_line(told: Told, logger: logging.Logger) -> None:
    logger.info("play of %s: %s", "walk", "complete\nforged")
    assert told.lines() == [
        {
            "time": "2027-01-15T08:00:00.000Z",
            "level": "info",
            "event": "record",
            "logger": "server.test",
            "message": "play of walk: complete\nforged",
        }
    ]


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
    assert "test_eventlog.py" in bug["traceback"]


def test_a_warning_that_repeats_is_told_once(told: Told, logger: logging.Logger) -> None:
    for _ in range(500):
        logger.error("socket.accept() out of system resource")
    logger.error("something else")
    assert [line["message"] for line in told.lines()] == [
        "socket.accept() out of system resource",
        "something else",
    ]


def test_a_record_that_cannot_be_formatted_is_told_all_the_same(
    told: Told, logger: logging.Logger, capsys: pytest.CaptureFixture[str]
) -> None:
    logger.warning("%d frames", "three")
    assert told.lines()[0]["message"].startswith("%d frames")
    assert capsys.readouterr().err == ""


def test_it_takes_the_place_of_other_handlers(
    told: Told, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    root = logging.RootLogger(logging.WARNING)
    root.addHandler(logging.StreamHandler())
    monkeypatch.setattr(logging, "getLogger", lambda: root)
    handler = RecordHandler(told.log)
    take_over_logging(handler)
    root.info("once")
    root.debug("not at all")
    assert [line["message"] for line in told.lines()] == ["once"]
    assert capsys.readouterr().err == ""
