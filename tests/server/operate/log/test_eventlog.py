"""Events and records of the logging module in one log."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import pytest

from codec.errors import CorruptError
from server.operate.log.eventlog import MAX_REPEATS, EventLog, RepeatFilter
from server.operate.log.logline import LogStyle


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


def test_many_warnings_are_not_remembered_for_ever() -> None:
    repeats = RepeatFilter()
    assert all(repeats.filter(warning(f"{n}")) for n in range(MAX_REPEATS + 1))
    assert not repeats.filter(warning(f"{MAX_REPEATS}"))
    assert repeats.filter(warning("0"))


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
    assert "test_eventlog.py" in bug["traceback"]


def test_an_event_that_is_no_line_is_counted_as_dropped(
    told: Told, capsys: pytest.CaptureFixture[str]
) -> None:
    told.log.event("request", path=Path("x"))  # type: ignore[arg-type]
    assert (told.lines(), told.log.num_dropped) == ([], 1)
    told.log.event("request", path="x")
    assert [(line["event"], line.get("lines")) for line in told.lines()] == [
        ("request", None),
        ("log_dropped", 1),
    ]
    assert capsys.readouterr().err == ""
