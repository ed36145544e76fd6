"""Captures read from a real S3 server: the same pictures as from a folder, in bounded memory."""

from __future__ import annotations

import io
import os
import random
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from codec.storage import objectstore
from codec.storage.objectstore import open_store
from tests.support.commands import ROOT
from tests.support.stores.s3_server import BUCKET, S3Server, s3_server
from tests.support.tiny_capture import write_dynamic3dgs, write_dynerf
from trainer.capture.layout import open_capture
from trainer.errors import CaptureError
from trainer.storedfiles import BLOCK_BYTES, StoredFile, forget_stored

FRAMES = 12
URL = f"s3://{BUCKET}/deep/capture"
KEY = "deep/capture"


@pytest.fixture(scope="module")
def server() -> Iterator[S3Server]:
    with s3_server() as server:
        yield server


@pytest.mark.parametrize("layout", ["dynerf", "dynamic3dgs"])
def test_pictures_are_those_of_the_folder_in_any_order(
    server: S3Server, tmp_path: Path, layout: str
) -> None:
    write = write_dynerf if layout == "dynerf" else write_dynamic3dgs
    write(tmp_path / "capture", 4, FRAMES)
    server.upload(tmp_path / "capture", f"{layout}/capture")
    # The object that consoles create for a folder.
    server.put(f"{layout}/capture/ims/", b"")
    here, there = (
        open_capture(tmp_path / "capture"),
        open_capture(f"s3://{BUCKET}/{layout}/capture/"),
    )
    assert there.layout == here.layout == layout
    assert there.root.name == "capture"
    assert there.num_frames == here.num_frames == FRAMES
    assert [c.held_out for c in there.cameras] == [c.held_out for c in here.cameras]
    rng = random.Random(0)
    for camera in range(4):
        ours, theirs = here.open_images(camera), there.open_images(camera)
        for frame in [0, 1, 2, *rng.sample(range(FRAMES), 4), FRAMES - 1, 0]:
            assert np.array_equal(ours.read(frame), theirs.read(frame))
        theirs.close()
    on_disk = sum(path.stat().st_size for path in there.root.rglob("*") if path.is_file())
    tables = (tmp_path / "capture").glob("*.[jnt]*")
    assert on_disk == sum(path.stat().st_size for path in tables)
    forget_stored()
    assert not there.root.parent.exists()


def test_what_is_wrong_is_told_by_its_url(
    server: S3Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(objectstore, "PATIENT", objectstore.BRIEF)
    write_dynamic3dgs(tmp_path / "pictures", 4, 3)
    write_dynerf(tmp_path / "videos", 3, 3)
    server.upload(tmp_path / "pictures", f"{KEY}/pictures")
    server.upload(tmp_path / "videos", f"{KEY}/videos")
    pictures, videos = open_capture(f"{URL}/pictures"), open_capture(f"{URL}/videos")
    server.put(f"{KEY}/pictures/ims/0/000001.png", b"not a picture")
    with pytest.raises(CaptureError, match=rf"^{URL}/pictures/ims/0/000001\.png: not a picture"):
        pictures.open_images(0).read(1)
    server.delete(f"{KEY}/pictures/ims/0/000002.png")
    with pytest.raises(CaptureError, match=rf"^{URL}/pictures/ims/0/000002\.png is missing"):
        pictures.open_images(0).read(2)
    with pytest.raises(CaptureError, match=rf"^{URL}/pictures/ims/0/000002\.png: is missing"):
        open_capture(f"{URL}/pictures")
    server.put(f"{KEY}/videos/cam00.mp4", b"short")
    with pytest.raises(CaptureError, match=rf"^{URL}/videos/cam00\.mp4 "):
        videos.open_images(0).read(0)
    server.stop()
    try:
        for source in (pictures.open_images(0), videos.open_images(1)):
            with pytest.raises(CaptureError, match=rf"^{URL}/.* cannot be read: ") as caught:
                source.read(0)
            assert "\n" not in str(caught.value)
        with pytest.raises(CaptureError, match=rf"^{URL}/.* cannot be read: "):
            open_capture(f"{URL}/pictures")
    finally:
        server.start()


def test_a_block_file_reads_what_is_there(server: S3Server) -> None:
    rng = random.Random(0)
    data = rng.randbytes(5 * BLOCK_BYTES + 12345)
    server.put("big", data)
    store = open_store(f"s3://{BUCKET}")
    file = io.BufferedReader(StoredFile(store, "big", len(data)), BLOCK_BYTES)
    for _ in range(100):
        at, size = rng.randrange(len(data) + 10), rng.choice((0, 1, 4096, BLOCK_BYTES))
        assert file.seek(at) == file.tell() == at
        found = file.read(size)
        assert found == data[at : at + len(found)]
        assert found or not size or at >= len(data)
    assert file.seek(-5, 2) == len(data) - 5
    assert file.read() == data[-5:]


MEMORY = """
import io, re, sys
from pathlib import Path
from codec.storage.objectstore import open_store
from trainer.storedfiles import BLOCK_BYTES, StoredFile
raw = StoredFile(open_store(sys.argv[1]), "video", int(sys.argv[2]))
file = io.BufferedReader(raw, BLOCK_BYTES)
def through(end):
    while file.tell() < end and file.read(1 << 15):
        pass
    # Not of `resource`, which counts what the parent had when it forked.
    return re.search(r"VmHWM:\\s+(\\d+) kB", Path("/proc/self/status").read_text())[1]
print(through(8 << 20), through(1 << 40), file.tell())
"""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs Linux")
def test_memory_of_a_long_video_is_its_blocks(server: S3Server) -> None:
    size = 48 << 20
    server.put("deep/video", bytes(size))
    done = subprocess.run(
        [sys.executable, "-c", MEMORY, f"s3://{BUCKET}/deep", str(size)],
        cwd=ROOT, env=os.environ, capture_output=True, text=True, timeout=100, check=True,
    )  # fmt: skip
    first_kb, all_kb, end = map(int, done.stdout.split())
    assert end == size
    # After the first blocks the other 40 MiB need hardly more memory.
    assert (all_kb - first_kb) << 10 <= 4 * BLOCK_BYTES
    assert first_kb < 200 << 10  # otherwise another process was measured
