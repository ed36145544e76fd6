"""One writer of an output at a time: every command that writes is refused beside another one."""

from __future__ import annotations

import errno
import fcntl
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from codec.errors import ConflictError
from codec.outputlock import writing_alone
from codec.stream.streampacker import pack_stream
from tests.support.commands import run
from tests.support.hostile import refused
from tests.support.tiny_stream import files_of, write_tiny

COMMANDS = [
    "stream import MODEL.ply OUT",
    "stream import MODELS OUT --fps 30 --follow",
    "stream import MODELS S --follow --resume",
    *("stream edit crop S OUT --box 0 0 0 1 1 1", "stream edit join S OUT --then S"),
    *("stream audio add S SOUND", "stream audio remove S"),
    *("stream captions add S VTT", "stream captions remove S"),
    *("stream pack S OUT.swings", "stream unpack PACKED.swings OUT"),
    *("stream export S OUT --static", "stream export S OUT.ply --frames 0:2"),
    *("train CAPTURE OUT", "train CAPTURE OUT --resume", "train CAPTURE OUT --ray local"),
    "synth OUT",
]
"""The first word that begins with OUT, or S, is what the command writes."""


@contextmanager
def held(output: Path, host: str = socket.gethostname()) -> Iterator[None]:
    """Holds the lock of `output` as another process does: its file is locked and names a holder."""
    with open(output.with_name(f".{output.name}.lock"), "w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        file.write(f"4711 {host}\n")
        file.flush()
        yield


def test_a_second_writer_is_refused_in_one_line(tmp_path: Path) -> None:
    write_tiny(tmp_path / "S", 5)
    pack_stream(tmp_path / "S", tmp_path / "PACKED.swings")
    for name in ("MODEL.ply", "MODELS/0.ply", "CAPTURE/videos"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    before = files_of(tmp_path)
    for words in COMMANDS:
        command, *rest = words.split()
        output = next((word for word in rest if word.startswith("OUT")), "S")
        with held(tmp_path / output):
            done = run(f"swings-{command}", *rest, folder=tmp_path)
        line = f"{output} is being written by process 4711; wait for it, or name another place"
        told = (done.returncode, done.stdout, done.stderr)
        assert told == (1, "", f"swings-{command}: {line}\n"), words
        assert files_of(tmp_path) == before


def test_what_a_killed_writer_left_locks_nothing(tmp_path: Path) -> None:
    lock, output = tmp_path / ".out.lock", tmp_path / "out"
    lock.write_text("4711 elsewhere\n")
    with writing_alone(output), writing_alone(output):
        assert lock.read_text() == f"{os.getpid()} {socket.gethostname()}\n"
    assert not lock.exists()
    with held(output, "elsewhere"):
        refused(ConflictError, "by process 4711 on elsewhere", writing_alone(output).__enter__)


def test_a_folder_that_nothing_can_lie_beside_is_locked_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def denied(path: Path, *flags: int) -> int:
        if path.suffix == ".lock":
            raise PermissionError(errno.EACCES, "denied")
        return opened(path, *flags)

    opened = os.open
    descriptor = opened(tmp_path, os.O_RDONLY)
    monkeypatch.setattr(os, "open", denied)
    for _ in range(2):
        with writing_alone(tmp_path), pytest.raises(BlockingIOError):
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    os.close(descriptor)
