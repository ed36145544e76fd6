"""A stream served by its own training run."""

from __future__ import annotations

import json
import signal
import socket
import urllib.request
from pathlib import Path

import pytest

from codec.errors import InvalidError, SwingsError
from codec.splats import Splats
from codec.stream import StreamReader, StreamWriter
from codec.stream.poster import POSTER_NAME
from tests.support.tiny_stream import append_tiny, tiny_manifest, tiny_slice
from tests.support.trainings import run_until, train_here
from tests.support.waiting import BOUND_S, wait_until
from trainer.fit.observer import Progress
from trainer.run.liveview import PREVIEW_S, SERVE_LOG_NAME, LiveView, Preview, watch_name

TINY = "--num-gs", 100, "--genesis-iterations", 20, "--settle-rounds", 1, "--window-iterations", 10


def server_in(line: str) -> str:
    """The server's address in the line that a training run prints."""
    assert line.startswith("watch it at ")
    server, _, name = line.split()[3].rpartition("/watch/")
    assert name == "show"
    return server


def is_up(server: str) -> bool:
    host, _, port = server.removeprefix("http://").rpartition(":")
    try:
        socket.create_connection((host, int(port)), BOUND_S).close()
    except OSError:
        return False
    return True


@pytest.fixture
def show(tmp_path: Path) -> Path:
    """A stream that is being written."""
    writer = StreamWriter.create(tmp_path / "show", tiny_manifest())
    append_tiny(writer, 4)
    writer.abort()
    return tmp_path / "show"


def test_the_server_shows_what_is_trained_and_ends_after_it(show: Path, tmp_path: Path) -> None:
    told = list[str]()
    with LiveView(show, 0, tmp_path, told.append) as view:
        for frame in (0, 1):
            view.window_begun(frame, 0)
        (line,) = told
        server = server_in(line)
        with urllib.request.urlopen(f"{server}/v1/streams", timeout=BOUND_S) as response:
            (stream,) = json.load(response)["streams"]
        assert (stream["name"], stream["live"]) == ("show", True)
    assert not is_up(server)
    assert (tmp_path / SERVE_LOG_NAME).exists()


def test_the_server_ends_with_a_run_that_is_killed(capture: Path, tmp_path: Path) -> None:
    words = capture, tmp_path / "show", *TINY, "--frames", "0:3", "--serve", 0
    done = run_until(signal.SIGKILL, 1, *words)
    (line,) = (line for line in done.stderr.splitlines() if line.startswith("watch"))
    wait_until(lambda: not is_up(server_in(line)))


def test_until_the_first_segment_the_poster_shows_the_scene_as_trained(show: Path) -> None:
    manifest, now_s, asked = StreamReader(show).manifest, [5.0], list[int]()
    (show / POSTER_NAME).unlink(missing_ok=True)

    def shown(frame: int) -> Splats:
        assert (show / POSTER_NAME).exists() == bool(asked)
        asked.append(frame)
        return tiny_slice(0).splats

    preview = Preview(show, manifest, shown, lambda: now_s[0])
    preview.window_begun(0, 0)  # at once
    for frame in (0, 0, 1, manifest.segment_frames):
        now_s[0] += PREVIEW_S - 1
        preview.progressed(Progress(frame, 10, 20, 0.5))
    assert asked == [0, 0]
    now_s[0] += PREVIEW_S
    preview.progressed(Progress(3, 10, 20, 0.5))
    preview.window_begun(4, 0)
    assert asked == [0, 0, 3]


def test_a_port_in_use_is_an_error(show: Path, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        told = f"--serve: the server does not start.*{port}"
        with LiveView(show, port, tmp_path, print) as view, pytest.raises(SwingsError, match=told):
            view.window_begun(0, 0)


def test_a_name_that_no_url_can_have_is_refused(capture: Path, tmp_path: Path) -> None:
    with pytest.raises(InvalidError, match="cannot be part of a URL"):
        train_here(capture, tmp_path / "my show", *TINY, "--serve", 0)
    assert not (tmp_path / "my show").exists()
    assert watch_name(tmp_path / "show") == "show"
    assert watch_name("s3://bucket/shows/show/") == "show"
    with pytest.raises(InvalidError):
        watch_name("s3://bucket/%20")
