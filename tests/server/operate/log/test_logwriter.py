"""The writer on real pipes and files, with readers that are slow, gone or killed with it."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from server.operate.log.logwriter import FLUSH_S, LogWriter
from tests.support.commands import ROOT

pytestmark = pytest.mark.realtime


def numbered(n: int, length: int = 20) -> bytes:
    return b"%0*d\n" % (length - 1, n)


def told(count: int) -> bytes:
    return b"dropped %d\n" % count


def read_until_closed(descriptor: int) -> bytes:
    with os.fdopen(descriptor, "rb") as file:
        return file.read()


def test_lines_come_together_and_in_order(tmp_path: Path) -> None:
    path = tmp_path / "log"
    with path.open("ab") as file, LogWriter(file.fileno()) as writer:
        for n in range(1000):
            writer.write(numbered(n))
        assert not path.read_bytes()  # they wait for others
        time.sleep(FLUSH_S + 0.3)
        assert path.read_bytes() == b"".join(map(numbered, range(1000)))


def test_an_urgent_line_takes_the_others_with_it_at_once(tmp_path: Path) -> None:
    path = tmp_path / "log"
    with path.open("ab") as file, LogWriter(file.fileno()) as writer:
        began_s = time.monotonic()
        writer.write(b"one\n")
        writer.write(b"two\n", urgent=True)
        while path.read_bytes() != b"one\ntwo\n":
            assert time.monotonic() < began_s + 5
            time.sleep(0.001)
        assert time.monotonic() - began_s < FLUSH_S


def test_before_it_starts_every_line_is_written_at_once(tmp_path: Path) -> None:
    path = tmp_path / "log"
    with path.open("ab") as file:
        LogWriter(file.fileno()).write(b"one\n")
        assert path.read_bytes() == b"one\n"


def test_a_sink_that_is_stuck_holds_nobody_up() -> None:
    reader, descriptor = os.pipe()
    writer = LogWriter(descriptor, told, max_bytes=200_000)
    with writer:
        longest_s = 0.0
        for n in range(50_000):
            began_s = time.perf_counter()
            writer.write(numbered(n))
            longest_s = max(longest_s, time.perf_counter() - began_s)
        assert longest_s < 0.2
        assert 10_000 < writer.num_dropped < 50_000
        # The reader wakes up: what was kept comes whole, and how much was dropped.
        read: list[bytes] = []
        thread = threading.Thread(target=lambda: read.append(read_until_closed(reader)))
        thread.start()
        time.sleep(0.3)
        writer.write(b"last\n", urgent=True)
        time.sleep(0.1)
        writer.close()
        os.close(descriptor)
        thread.join(10)
    lines = read[0].splitlines(keepends=True)
    assert lines.count(told(writer.num_dropped)) == 1
    kept = [line for line in lines if line[:1] == b"0"]
    assert kept == sorted(kept)
    assert len(kept) + writer.num_dropped == 50_000
    assert lines[-1] == b"last\n"


def test_a_reader_that_has_gone_is_not_an_error() -> None:
    reader, descriptor = os.pipe()
    os.close(reader)
    with LogWriter(descriptor) as writer:
        for n in range(10):
            writer.write(numbered(n), urgent=True)
            time.sleep(0.01)
    os.close(descriptor)
    assert writer.num_dropped == 10


def test_a_sink_that_is_stuck_at_the_end_does_not_keep_the_process() -> None:
    reader, descriptor = os.pipe()
    code = (
        "import sys\n"
        "from server.operate.log.logwriter import LogWriter\n"
        "writer = LogWriter(1)\n"
        "writer.start()\n"
        "for n in range(20_000): writer.write(b'x' * 19 + bytes([10]))\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT, stdout=descriptor)
    os.close(descriptor)
    assert process.wait(timeout=30) == 0
    os.close(reader)


def test_lines_that_wait_are_written_when_the_process_ends_by_an_exception(tmp_path: Path) -> None:
    code = (
        "from server.operate.log.logwriter import LogWriter\n"
        "writer = LogWriter(1)\n"
        "writer.start()\n"
        "writer.write(b'waits\\n')\n"
        "raise ValueError\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True)
    assert (done.returncode, done.stdout) == (1, b"waits\n")


def test_processes_that_share_a_pipe_do_not_tear_each_others_lines() -> None:
    code = (
        "import sys\n"
        "from server.operate.log.logwriter import LogWriter\n"
        "with LogWriter(1, max_bytes=10**7) as writer:\n"
        "    for n in range(20_000): writer.write((sys.argv[1] * 199 + '\\n').encode())\n"
        "    writer.close(30)\n"
    )
    reader, descriptor = os.pipe()
    processes = [
        subprocess.Popen([sys.executable, "-c", code, word], cwd=ROOT, stdout=descriptor)
        for word in "abc"
    ]
    os.close(descriptor)
    lines = read_until_closed(reader).splitlines()
    assert [process.wait(timeout=30) for process in processes] == [0, 0, 0]
    assert sorted(set(lines)) == [b"a" * 199, b"b" * 199, b"c" * 199]
    assert len(lines) == 60_000
