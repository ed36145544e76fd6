"""From an object store to an object store: capture, training, kills, scores; a real S3 server."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from codec.errors import SwingsError
from codec.storage import objectstore
from codec.tools.audit import verify_stream
from tests.support.commands import ROOT, run, run_ok
from tests.support.stores.s3_server import BUCKET, S3Server, s3_server
from tests.support.tiny_capture import write_dynerf
from tests.support.trainings import contents, run_until, train_here
from trainer.fit.observer import Observer
from trainer.run.runlog import LOG_NAME

FRAMES = 6
SETTINGS = (
    "--num-gs", 100, "--genesis-iterations", 40, "--settle-rounds", 1, "--window-iterations", 20,
    "--segment-frames", 2, "--mcmc.relocate-period", 10, "--swin-size", 2, "--snapshot-every", 0,
)  # fmt: skip
CAPTURE = f"s3://{BUCKET}/captures/show"


@pytest.fixture(scope="module")
def server() -> Iterator[S3Server]:
    with s3_server() as server:
        yield server


@pytest.fixture(scope="module")
def whole(server: S3Server, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The stream trained from and to folders; its capture is in the store, too."""
    path = tmp_path_factory.mktemp("whole") / "show"
    write_dynerf(path, 4, FRAMES)
    server.upload(path, "captures/show")
    train_here(path, path.parent / "stream", *SETTINGS)
    return contents(path.parent / "stream")


def test_the_commands_of_the_manual_write_the_bytes_of_folders(
    server: S3Server, whole: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    manual = (ROOT / "docs" / "OPERATE.md").read_text(encoding="utf-8")
    section = manual.partition("\n## Object stores\n")[2].partition("\n## ")[0]
    lines = [line.split() for line in section.splitlines() if line.startswith("    swings-")]
    train, resume, *read, serve = [
        [word.replace("BUCKET", BUCKET) for word in words] for words in lines
    ]
    assert resume == [*train, "--resume"]
    stopped = run_until(signal.SIGINT, 3, *train[1:], *SETTINGS)
    assert "stopped after frame 3; --resume continues from there" in stopped.stderr
    assert run_ok(*resume) == f"{train[2]}\n"
    assert server.files("streams/show") == whole
    assert [path.name for path in Path("show.work").iterdir()] == [LOG_NAME]
    assert [words[0] for words in read] == ["swings-stream", "swings-eval"]
    verified, scored = (run_ok(*words) for words in read)
    assert f"{FRAMES} frames" in verified
    assert f"{FRAMES} frames" in scored
    assert serve == ["swings-serve", train[2].removesuffix("/show")]
    again = run(*train, *SETTINGS)
    assert (again.returncode, again.stderr.count("\n")) == (1, 1)
    assert f"{train[2]} is not empty" in again.stderr


def test_killed_and_resumed_it_writes_the_same_bytes(
    server: S3Server, whole: dict[str, bytes], tmp_path: Path
) -> None:
    url, work = f"s3://{BUCKET}/killed/show", tmp_path / "work"
    done = run_until(signal.SIGKILL, 3, CAPTURE, url, "--work", work, *SETTINGS)
    assert done.returncode == -signal.SIGKILL, done.stderr
    assert verify_stream(url).num_frames == 2
    assert server.files("killed/show").keys() < whole.keys()
    # Its settings are in the work folder, so that no option has to be repeated.
    run_ok("swings-train", CAPTURE, url, "--work", work, "--resume")
    assert server.files("killed/show") == whole


def test_a_store_that_goes_in_the_middle_is_an_error_and_resume_goes_on(
    server: S3Server, whole: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Stopping(Observer):
        def window_begun(self, first_frame: int, done: int) -> None:
            if first_frame == 3:
                server.stop()

    monkeypatch.setattr(objectstore, "PATIENT", objectstore.BRIEF)
    words = CAPTURE, f"s3://{BUCKET}/gone/show", "--work", tmp_path / "work"
    with pytest.raises(SwingsError, match=f"^s3://{BUCKET}/"):
        train_here(*words, *SETTINGS, observers=[Stopping()])
    server.start()
    assert verify_stream(words[1]).live
    train_here(*words, "--resume")
    assert server.files("gone/show") == whole


def test_a_capture_that_is_not_there_is_named(server: S3Server, tmp_path: Path) -> None:
    for url in (f"s3://{BUCKET}/nothing", "s3://no-such-bucket/x"):
        with pytest.raises(SwingsError, match=url):
            train_here(url, tmp_path / "s")
    assert not (tmp_path / "s").exists()
