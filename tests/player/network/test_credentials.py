"""Name and password in a URL are sent to their host, and appear in no message, report or log."""

from __future__ import annotations

import json
import subprocess
from contextlib import closing
from functools import partial
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import codec
from codec.errors import SwingsError
from codec.framerange import FrameRange
from codec.storage.objectstore import without_credentials
from player.network.fetch import FetchError
from player.network.target import logins_of
from player.script.openscene import Scene
from player.source.opener import Opener, opened
from tests.player.network.webhosts import LOGIN, LOGIN_HEADER, SECRETS, web_host
from tests.support.commands import run

guarded = partial(web_host, login=LOGIN_HEADER)
"""A static host that requires the password."""


def assert_hidden(text: str) -> None:
    for secret in SECRETS:
        assert secret not in text, text


def play(*words: object) -> subprocess.CompletedProcess[str]:
    done = run("swings-play", *words, "--renderer", "cpu")
    assert_hidden(done.stdout + done.stderr)
    return done


def test_a_play_with_a_password_reports_without_it(folder: Path, tmp_path: Path) -> None:
    with guarded(folder) as host:
        url, out = f"http://{LOGIN}@127.0.0.1:{host.server_port}/s", tmp_path / "out.mp4"
        report = tmp_path / "report.json"
        done = play(url, "--capture", out, "--report", report, "--verbose")
        assert done.returncode == 0, done.stderr
        assert set(host.logins) == {LOGIN_HEADER}
        assert f"6 frames of http://127.0.0.1:{host.server_port}/s, drawn by" in done.stdout
        assert_hidden(report.read_text())
        assert json.loads(report.read_text())["source"].endswith(f"{host.server_port}/s")


@pytest.mark.parametrize(
    ("url", "words", "code"),
    [
        ("http://{login}@127.0.0.1:1/s", "--capture o.mp4", 1),
        ("http://{login}@127.0.0.1:1/s,http://{login}@127.0.0.1:2/s", "--capture o.mp4", 1),
        ("http://{login}@127.0.0.1:99999/s", "--capture o.png --still 0", 1),
        ("http://{login}@/s", "--capture o.mp4", 1),
        ("http://{login}@[::1/s", "--capture o.mp4", 1),
        ("ftp://{login}@127.0.0.1/s", "--capture o.png --still 0", 1),
        ("https://{login}@127.0.0.1/s", "--link 8M", 2),
        ("https://{login}@127.0.0.1/s", "--profile o.png", 2),
    ],
)
def test_errors_are_without_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, url: str, words: str, code: int
) -> None:
    monkeypatch.chdir(tmp_path)
    done = play(url.format(login=LOGIN), *words.split(), "--patience", 0)
    assert done.returncode == code
    assert code == 2 or done.stderr.count("\n") == 1


def test_in_python(folder: Path) -> None:
    with guarded(folder) as host:
        url = f"http://{LOGIN}@127.0.0.1:{host.server_port}/s"
        with Scene.open(url, renderer="cpu") as scene:
            assert scene.num_frames == 6
            assert len(scene.splats(2)) > 0
            assert_hidden(scene.name)
        with closing(Opener(url)) as opener:
            assert opener.preview() is not None
            assert_hidden(opener.name)
    for open_it in (codec.open_stream, Scene.open):
        for name in (url, f"ftp://{LOGIN}@127.0.0.1/s", f"s3x://{LOGIN}@bucket/s"):
            with pytest.raises(SwingsError) as error:
                open_it(name)
            assert_hidden(str(error.value))


def test_it_goes_to_its_own_host_alone(folder: Path) -> None:
    with guarded(folder) as other, guarded(folder) as host:
        url = f"http://{LOGIN}@127.0.0.1:{host.server_port}/s"
        free = f"http://127.0.0.1:{other.server_port}/s"
        with opened(f"{url},{free}", FrameRange(0)) as source:
            assert len(list(source.packets())) > 0
        assert logins_of([url, free, "my-stream", "http://[/"]) == {
            ("http", "127.0.0.1", host.server_port): LOGIN_HEADER
        }
        host.moved_to = free.removesuffix("/s").replace("127.0.0.1", "localhost")
        with pytest.raises(FetchError, match="another host"), opened(url):
            pass
        assert set(host.logins) == {LOGIN_HEADER}
        assert LOGIN_HEADER not in other.logins


@given(st.text("ab:@%é ,", max_size=12), st.sampled_from(["/p@th", "?q=a@b", "#a@b", ""]))
def test_what_is_left_of_a_url(login: str, rest: str) -> None:
    login = login.replace(" ", "")
    assert without_credentials(f"{login}") == login
    assert without_credentials(f"no http://{login}@host{rest} here") == f"no http://host{rest} here"
