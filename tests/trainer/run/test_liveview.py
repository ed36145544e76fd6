"""A stream served by its own training run."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import urllib.request
from pathlib import Path

import pytest

from codec.errors import InvalidError
from tests.support.commands import run, started
from tests.support.tiny_capture import write_dynerf
from tests.support.waiting import wait_until
from trainer.run.liveview import SERVE_LOG_NAME, watch_name

SETTINGS = (
    "--num-gs", 200, "--genesis-iterations", 60, "--settle-rounds", 1, "--window-iterations", 40,
    "--segment-frames", 2,
)  # fmt: skip
FRAMES = 8


@pytest.fixture
def capture(tmp_path: Path) -> Path:
    write_dynerf(tmp_path / "capture", 4, FRAMES)
    return tmp_path / "capture"


def streams(server: str) -> list[dict[str, object]]:
    with urllib.request.urlopen(f"{server}/v1/streams", timeout=10) as response:
        found: list[dict[str, object]] = json.load(response)["streams"]
        return found


def address_in(process: subprocess.Popen[str]) -> str:
    """The address of the server that a training run prints on standard error."""
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith("watch it at "):
            server, _, name = line.split()[3].rpartition("/watch/")
            assert name == "show"
            return server
    raise AssertionError("the run ended without a server")


def is_up(server: str) -> bool:
    host, _, port = server.removeprefix("http://").rpartition(":")
    try:
        socket.create_connection((host, int(port)), 1).close()
    except OSError:
        return False
    return True


@pytest.mark.parametrize("end", ["alone", "Ctrl-C", "kill"])
def test_the_server_shows_what_is_trained_and_ends_with_the_run(
    capture: Path, tmp_path: Path, end: str
) -> None:
    process = started("swings-train", capture, tmp_path / "show", *SETTINGS, "--serve", 0)
    try:
        server = address_in(process)
        (stream,) = streams(server)
        assert (stream["name"], stream["live"]) == ("show", True)
        if end == "alone":
            assert process.stderr is not None
            process.stderr.read()
            assert process.wait(60) == 0
        else:
            process.send_signal(signal.SIGINT if end == "Ctrl-C" else signal.SIGKILL)
            process.wait(60)
        wait_until(lambda: not is_up(server), 10)
    finally:
        process.kill()
        process.communicate()
    assert (tmp_path / "show" / SERVE_LOG_NAME).exists()


def test_a_port_in_use_is_one_line_before_anything_is_trained(
    capture: Path, tmp_path: Path
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        done = run("swings-train", capture, tmp_path / "show", *SETTINGS, "--serve", port)
    assert done.returncode == 1
    last = done.stderr.splitlines()[-1]
    assert "--serve: the server does not start" in last
    assert str(port) in last


def test_a_name_that_no_url_can_have_is_refused(capture: Path, tmp_path: Path) -> None:
    done = run("swings-train", capture, tmp_path / "my show", *SETTINGS, "--serve", 0)
    assert (done.returncode, done.stdout) == (1, "")
    assert "cannot be part of a URL" in done.stderr
    assert not (tmp_path / "my show").exists()
    assert watch_name(tmp_path / "show") == "show"
    assert watch_name("s3://bucket/shows/show/") == "show"
    with pytest.raises(InvalidError):
        watch_name("s3://bucket/%20")
