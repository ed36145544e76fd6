"""From an object store to an object store: capture, training, kills, serving; a real S3 server."""

from __future__ import annotations

import json
import random
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from codec.tools.audit import verify_stream
from tests.support.commands import ROOT, environment, run, run_ok, serving, started
from tests.support.stores.s3_server import BUCKET, S3Server, s3_server
from tests.support.tiny_capture import write_dynamic3dgs, write_dynerf
from trainer.run.checkpoint import CHECKPOINT_NAME
from trainer.run.runlog import LOG_NAME

FRAMES = 6
SETTINGS = (
    "--num-gs", 200, "--genesis-iterations", 60, "--settle-rounds", 1, "--window-iterations", 40,
    "--segment-frames", 2, "--mcmc.relocate-period", 10, "--swin-size", 2,
)  # fmt: skip
KILLS = 3

WRITE: dict[str, Callable[[Path], object]] = {
    "dynerf": lambda path: write_dynerf(path, 4, FRAMES),
    "dynamic3dgs": lambda path: write_dynamic3dgs(path, 4, FRAMES),
}


@pytest.fixture(scope="module")
def server() -> Iterator[S3Server]:
    with s3_server() as server:
        yield server


@pytest.fixture(scope="module", params=WRITE)
def layout(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def whole(
    server: S3Server, layout: str, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, bytes]:
    """The stream trained from and to folders; its capture is in the store, too."""
    path = tmp_path_factory.mktemp("whole") / layout
    WRITE[layout](path)
    server.upload(path, f"captures/{layout}")
    stream = path.parent / "stream"
    run_ok("swings-train", path, stream, *SETTINGS, "--title", "one", "--snapshot-every", 0)
    return {
        str(f.relative_to(stream)): f.read_bytes()
        for f in stream.rglob("*")
        if f.is_file() and f.name != LOG_NAME
    }


def capture_url(layout: str) -> str:
    return f"s3://{BUCKET}/captures/{layout}"


def test_from_store_to_store_are_the_bytes_of_folders(
    server: S3Server, layout: str, whole: dict[str, bytes], tmp_path: Path
) -> None:
    key = f"streams/{layout}"
    url, work = f"s3://{BUCKET}/{key}", tmp_path / "work"
    told = run_ok(
        "swings-train", capture_url(layout), url, "--work", work, *SETTINGS, "--title", "one"
    )
    assert told == f"{url}\n"
    assert server.files(key) == whole
    assert sorted(p.name for p in work.iterdir()) == ["snapshots", LOG_NAME]
    assert f"{FRAMES} frames" in run_ok("swings-stream", "verify", url)
    info = json.loads(run_ok("swings-stream", "info", url, "--json"))
    assert info["num_frames"] == FRAMES
    scores = json.loads(run_ok("swings-eval", url, capture_url(layout), "--json"))
    assert (scores["stream"], scores["frames"]) == (url, FRAMES)
    run_ok("swings-stream", "export", url, tmp_path / "frame.ply", "--frame", 3)
    with serving(f"s3://{BUCKET}/streams") as base:
        listed = urllib.request.urlopen(f"{base}/v1/streams/{layout}/manifest.json").read()
    assert listed == whole["manifest.json"]
    again = run("swings-train", capture_url(layout), url, "--work", tmp_path / "w", *SETTINGS)
    assert (again.returncode, again.stderr.count("\n")) == (1, 1)
    assert f"{url} is not empty" in again.stderr


def test_the_commands_of_the_manual_run(
    server: S3Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_dynerf(tmp_path / "show", 4, FRAMES)
    server.upload(tmp_path / "show", "captures/show")
    manual = (ROOT / "docs" / "OPERATE.md").read_text(encoding="utf-8")
    section = manual.partition("\n## Object stores\n")[2].partition("\n## ")[0]
    lines = [line.split() for line in section.splitlines() if line.startswith("    swings-")]
    train, resume, *others = [[word.replace("BUCKET", BUCKET) for word in words] for words in lines]
    assert resume == [*train, "--resume"]
    # Stopped before its end, so that there is work left to resume.
    stopped = started("swings-train", *train[1:], *SETTINGS, "--window-iterations", 400)
    deadline_s = time.monotonic() + 120
    while not (tmp_path / "show.work" / LOG_NAME).exists():
        assert stopped.poll() is None
        assert time.monotonic() < deadline_s
        time.sleep(0.01)
    stopped.send_signal(signal.SIGINT)
    assert "--resume continues from there" in stopped.communicate()[1]
    run_ok(*resume)
    *read, (_, root) = others
    assert [words[0] for words in others] == ["swings-stream", "swings-eval", "swings-serve"]
    for words in read:
        assert run_ok(*words)
    with serving(root) as base:
        assert urllib.request.urlopen(f"{base}/v1/streams/show/manifest.json").status == 200


@pytest.mark.parametrize("layout", ["dynerf"], indirect=True)
def test_killed_and_resumed_it_writes_the_same_bytes(
    server: S3Server, layout: str, whole: dict[str, bytes], tmp_path: Path
) -> None:
    key = f"killed/{layout}"
    url, work = f"s3://{BUCKET}/{key}", tmp_path / "work"
    kept = work / CHECKPOINT_NAME
    rng = random.Random(1)
    arguments = [capture_url(layout), url, "--work", work, *SETTINGS, "--title", "one"]
    for kill in range(KILLS):
        process = started("swings-train", *arguments, *(["--resume"] if kill else []))
        before = kept.stat().st_mtime_ns if kept.exists() else 0
        deadline_s = time.monotonic() + 120
        while not kept.exists() or kept.stat().st_mtime_ns == before:
            assert process.poll() is None, process.stderr and process.stderr.read()
            assert time.monotonic() < deadline_s
            time.sleep(0.002)
        time.sleep(rng.uniform(0, 0.3))
        process.send_signal(signal.SIGKILL)
        process.communicate()
        found = server.files(key)
        if "manifest.json" in found:
            verify_stream(url)
        assert found.keys() <= whole.keys()
        if not kept.exists():  # the run was faster
            break
    if kept.exists():
        # Its settings are in the work folder, so that no option has to be repeated.
        done = run("swings-train", capture_url(layout), url, "--work", work, "--resume")
        if done.returncode:  # killed with all segments written, before the last pictures were
            assert "is finished; there is nothing to resume" in done.stderr
            written = server.files(key)
            whole = {**whole, "poster.jpg": written["poster.jpg"]}
            if "storyboard.webp" not in written:
                del whole["storyboard.webp"]
    assert server.files(key) == whole


# A separate process, because a process that compiles kernels may round differently. It trains with
# its arguments, and waits for a line before it trains frame 3.
WAITING = """
import sys
import tyro
from rich.console import Console
from codec.errors import SwingsError
from codec.storage import objectstore
from trainer.fit.observer import Observer
from trainer.run.job import train_stream
from trainer.run.preset import PRESETS
objectstore.PATIENT = objectstore.BRIEF

class Waits(Observer):
    def window_begun(self, first_frame, done):
        if first_frame == 3:
            print("waiting", flush=True)
            sys.stdin.readline()

try:
    train_stream(tyro.cli(PRESETS["cpu"]), Console(quiet=True), observers=[Waits()])
except SwingsError as error:
    print(error)
"""


@pytest.mark.parametrize("layout", ["dynamic3dgs"], indirect=True)
def test_a_store_that_goes_in_the_middle_is_one_line_and_resume_goes_on(
    server: S3Server, layout: str, whole: dict[str, bytes], tmp_path: Path
) -> None:
    key = f"gone/{layout}"
    url, work = f"s3://{BUCKET}/{key}", tmp_path / "work"
    arguments = (
        *(capture_url(layout), url, "--work", work, *SETTINGS),
        *("--title", "one", "--snapshot-every", 0),
    )
    process = subprocess.Popen(
        [sys.executable, "-c", WAITING, *map(str, arguments)],
        env=environment(),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "waiting\n"
    server.stop()
    said, _ = process.communicate("go on\n", timeout=120)
    server.start()
    assert said.count("\n") == 1
    assert said.startswith(f"s3://{BUCKET}/")
    assert verify_stream(url).live
    run_ok("swings-train", capture_url(layout), url, "--work", work, "--resume")
    assert server.files(key) == whole


def test_a_capture_that_is_not_there_is_one_line(server: S3Server, tmp_path: Path) -> None:
    for url in (f"s3://{BUCKET}/nothing", "s3://no-such-bucket/x"):
        done = run("swings-train", url, tmp_path / "s")
        assert (done.returncode, done.stderr.count("\n")) == (1, 1)
        assert url in done.stderr
    assert not (tmp_path / "s").exists()
