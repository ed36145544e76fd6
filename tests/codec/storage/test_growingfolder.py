"""Objects that threads write: no thread keeps writing after an interrupt was raised."""

from __future__ import annotations

import signal
import threading
from pathlib import Path

import pytest

from codec.storage import growingfolder
from codec.storage.growingfolder import GrowingFolder
from codec.storage.growingplace import Shape
from tests.support.hostile import refused


@pytest.mark.parametrize("last", [1, 2, 3])
def test_no_thread_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, last: int) -> None:
    """Ctrl-C arrives while thread number `last` starts, before its pool has registered it; the
    writes begun until then go on after it."""
    place = GrowingFolder(tmp_path / "s", Shape(log="log", head="head", folder="objects"))
    place.begin(b"{}")
    started: list[threading.Thread] = []
    begun: list[Path] = []
    ended: list[Path] = []
    raised = threading.Event()

    def write_slowly(path: Path, data: bytes) -> None:
        begun.append(path)
        raised.wait()
        ended.append(path)

    def start_interrupted(thread: threading.Thread) -> None:
        start(thread)
        started.append(thread)
        if len(started) == last:
            try:
                signal.raise_signal(signal.SIGINT)
            finally:
                raised.set()

    start = threading.Thread.start
    monkeypatch.setattr(growingfolder, "write_atomic", write_slowly)
    monkeypatch.setattr(threading.Thread, "start", start_interrupted)
    refused(KeyboardInterrupt, "", place.add, 0, {str(number): b"" for number in range(4)})
    assert len(begun) == len(ended) == 4
    assert not any(thread.is_alive() for thread in started)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
