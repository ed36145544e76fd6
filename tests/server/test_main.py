"""swings-serve as a process: the ready line, signals, and one clear line for each mistake."""

from __future__ import annotations

import json
import re
import signal
import socket
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from server.operate.sign.signing import add_key
from tests.support.commands import IDLE, ROOT, run
from tests.support.server.running_server import make_stream
from tests.support.waiting import BOUND_S


@contextmanager
def serving(*arguments: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Runs `python -m server` until it is ready; gives the process and its URL."""
    process = subprocess.Popen(
        [sys.executable, "-m", "server", *arguments, *IDLE],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    with process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            match = re.fullmatch(r"serving (http://\S+)\n", line)
            assert match, (line, process.stderr and process.stderr.read())
            yield process, match[1]
        finally:
            process.kill()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_it_says_when_it_is_ready_and_ends_on_a_signal(
    tmp_path: Path, number: signal.Signals
) -> None:
    make_stream(tmp_path / "walk", 3)
    make_stream(tmp_path / "dance", 3)
    keys = tmp_path / "keys"
    add_key(keys)
    options = "--keys", str(keys), "--log-requests", "all"
    with serving(str(tmp_path), "--port", "0", *options) as (process, url):
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+", url)
        with urllib.request.urlopen(f"{url}/readyz", timeout=BOUND_S) as response:
            assert response.read() == b"ready\n"
        assert process.stdout is not None
        line = f"opens with links of: swings-sign {keys} STREAM --url {url}\n"
        assert process.stdout.readline() == line
        process.send_signal(number)
        out, err = process.communicate(timeout=BOUND_S)
        assert (process.returncode, out) == (0, "")
        lines = err.splitlines()
        assert [line.split()[1] for line in lines] == ["info"] * 3
        assert "dance is served: 3 frames" in lines[0]
        assert re.search(r"method=GET path=/readyz status=200 bytes=\d+ ms=", lines[2])


def test_a_folder_without_a_stream_is_served_and_the_log_says_so(tmp_path: Path) -> None:
    with serving(str(tmp_path), "--port", "0") as (process, url):
        with urllib.request.urlopen(f"{url}/v1/streams", timeout=BOUND_S) as response:
            assert json.load(response) == {"streams": [], "broken": []}
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate(timeout=BOUND_S)
    assert f"warning no_stream_yet root={tmp_path}" in err


def test_mistakes_are_one_clear_line(tmp_path: Path) -> None:
    good = make_stream(tmp_path / "good", 3)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        cases = [
            ([str(tmp_path / "absent")], "is not a folder"),
            ([str(tmp_path / "absent"), "--workers", "2"], "is not a folder"),
            ([str(good / "manifest.json")], "is not a folder"),
            (["s3://"], "s3://"),
            (["ftp://host/streams"], "choose a folder on this machine, or a URL of s3://"),
            ([str(good), "--port", port], f"port {port}"),
            ([str(good), "--port", "70000"], "70000"),
            ([str(good), "--host", "no.such.host.invalid"], "no.such.host.invalid"),
        ]
        for arguments, word in cases:
            done = run("swings-serve", *arguments)
            assert (done.returncode, done.stdout) == (1, ""), (arguments, done.stderr)
            assert done.stderr.count("\n") == 1, done.stderr
            assert done.stderr.startswith("swings-serve: "), done.stderr
            assert word in done.stderr, (word, done.stderr)
