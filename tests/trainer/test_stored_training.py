"""Captures and streams in a real S3 server: the pictures and bytes of folders."""

from __future__ import annotations

import io
import random
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from codec.errors import SwingsError
from codec.storage import objectstore
from codec.storage.objectstore import open_store
from codec.tools.audit import verify_stream
from tests.support.commands import ROOT, run, run_ok
from tests.support.hostile import refused
from tests.support.stores.s3_server import BUCKET, S3Server
from tests.support.tiny_capture import write_dynamic3dgs, write_dynerf
from tests.support.tiny_models import write_easymocap
from tests.support.trainings import contents, run_until, train_here
from trainer.capture.layout import open_capture
from trainer.errors import CaptureError
from trainer.fit.observer import Observer
from trainer.run.monitor import LOG_NAME
from trainer.storedfiles import BLOCK_BYTES, StoredFile, forget_stored

FRAMES = 6
SETTINGS = (
    "--num-gs", 100, "--genesis-iterations", 40, "--settle-rounds", 1, "--window-iterations", 20,
    "--segment-frames", 2, "--mcmc.relocate-period", 10, "--swin-size", 2, "--snapshot-every", 0,
)  # fmt: skip
CAPTURE = f"s3://{BUCKET}/captures/show"


@pytest.fixture(scope="module")
def whole(s3: S3Server, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The stream trained from and to folders; its capture is in the store, too."""
    path = tmp_path_factory.mktemp("whole") / "show"
    write_dynerf(path, 4, FRAMES)
    s3.upload(path, "captures/show")
    train_here(path, path.parent / "stream", *SETTINGS)
    return contents(path.parent / "stream")


def test_the_commands_of_the_manual_write_the_bytes_of_folders(
    s3: S3Server, whole: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
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
    assert s3.files("streams/show") == whole
    assert [path.name for path in Path("show.work").iterdir()] == [LOG_NAME]
    assert [words[0] for words in read] == ["swings-stream", "swings-eval"]
    verified, scored = (run_ok(*words) for words in read)
    assert f"{FRAMES} frames" in verified
    assert f"{FRAMES} frames" in scored
    assert serve == ["swings-serve", train[2].removesuffix("/show")]
    again = run(*train, *SETTINGS)
    assert (again.returncode, again.stderr.count("\n")) == (1, 1)
    assert f"{train[2]} is not empty" in again.stderr


def test_a_store_that_goes_in_the_middle_is_an_error_and_resume_goes_on(
    s3: S3Server, whole: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Stopping(Observer):
        def window_begun(self, first_frame: int, done: int) -> None:
            if first_frame == 3:
                s3.stop()

    quick = objectstore.RetryPolicy(1.0, 0.001, 0.001, max_retries=1)
    monkeypatch.setattr(objectstore, "PATIENT", quick)
    words = CAPTURE, f"s3://{BUCKET}/gone/show", "--work", tmp_path / "work"
    refused(SwingsError, f"^s3://{BUCKET}/", train_here, *words, *SETTINGS, observers=[Stopping()])
    s3.start()
    assert verify_stream(words[1]).live
    train_here(*words, "--resume")
    assert s3.files("gone/show") == whole


@pytest.mark.parametrize(
    ("layout", "write"),
    [("dynerf", write_dynerf), ("dynamic3dgs", write_dynamic3dgs), ("easymocap", write_easymocap)],
)
def test_pictures_are_those_of_a_folder(
    s3: S3Server, tmp_path: Path, layout: str, write: Callable[[Path, int, int], object]
) -> None:
    write(tmp_path / "capture", 4, 12)
    s3.upload(tmp_path / "capture", f"{layout}/capture")
    # The object that consoles create for a folder.
    s3.put(f"{layout}/capture/ims/", b"")
    here = open_capture(tmp_path / "capture")
    there = open_capture(f"s3://{BUCKET}/{layout}/capture/")
    assert there.layout == here.layout == layout
    assert there.root.name == "capture"
    assert there.num_frames == here.num_frames == 12
    assert [c.held_out for c in there.cameras] == [c.held_out for c in here.cameras]
    rng = random.Random(0)
    for camera in range(4):
        ours, theirs = here.open_images(camera), there.open_images(camera)
        for frame in [0, 1, 2, *rng.sample(range(12), 4), 12 - 1, 0]:
            assert np.array_equal(ours.read(frame), theirs.read(frame))
        theirs.close()
    on_disk = sum(path.stat().st_size for path in there.root.rglob("*") if path.is_file())
    tables = (tmp_path / "capture").glob("*.[jnty]*")
    assert on_disk == sum(path.stat().st_size for path in tables)
    forget_stored()
    assert not there.root.parent.exists()


def test_urls_in_errors(s3: S3Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(objectstore, "PATIENT", objectstore.BRIEF)
    for url in (f"s3://{BUCKET}/nothing", "s3://no-such-bucket/x"):
        refused(SwingsError, url, train_here, url, tmp_path / "s")
    assert not (tmp_path / "s").exists()
    url = f"s3://{BUCKET}/wrong"
    write_dynamic3dgs(tmp_path / "pictures", 4, 3)
    write_dynerf(tmp_path / "videos", 3, 3)
    s3.upload(tmp_path / "pictures", "wrong/pictures")
    s3.upload(tmp_path / "videos", "wrong/videos")
    pictures, videos = open_capture(f"{url}/pictures"), open_capture(f"{url}/videos")
    s3.put("wrong/pictures/ims/0/000001.png", b"not a picture")
    s3.delete("wrong/pictures/ims/0/000002.png")
    s3.put("wrong/videos/cam00.mp4", b"short")
    for ask, told in (
        (lambda: pictures.open_images(0).read(1), r"pictures/ims/0/000001\.png: not a picture"),
        (lambda: pictures.open_images(0).read(2), r"pictures/ims/0/000002\.png is missing"),
        (lambda: open_capture(f"{url}/pictures"), r"pictures/ims/0/000002\.png: is missing"),
        (lambda: videos.open_images(0).read(0), r"videos/cam00\.mp4 "),
    ):
        refused(CaptureError, f"^{url}/{told}", ask)
    s3.stop()
    says = rf"^{url}/.* cannot be read: "
    try:
        for source in (pictures.open_images(0), videos.open_images(1)):
            assert "\n" not in str(refused(CaptureError, says, source.read, 0))
        refused(CaptureError, says, open_capture, f"{url}/pictures")
    finally:
        s3.start()


class Counted(StoredFile):
    asked: ClassVar[list[int]] = []

    def readinto(self, buffer: Any) -> int:
        self.asked.append(len(buffer))
        return super().readinto(buffer)


def test_a_block_file_reads_what_is_there_block_by_block(s3: S3Server) -> None:
    rng = random.Random(0)
    data = rng.randbytes(5 * BLOCK_BYTES + 12345)
    s3.put("big", data)
    store = open_store(f"s3://{BUCKET}")
    file = io.BufferedReader(Counted(store, "big", len(data)), BLOCK_BYTES)
    for _ in range(100):
        at, size = rng.randrange(len(data) + 10), rng.choice((0, 1, 4096, BLOCK_BYTES))
        assert file.seek(at) == file.tell() == at
        found = file.read(size)
        assert found == data[at : at + len(found)]
        assert found or not size or at >= len(data)
    assert file.seek(-5, 2) == len(data) - 5
    assert file.read() == data[-5:]
    assert max(Counted.asked) <= BLOCK_BYTES  # which is all the memory that a long video takes
