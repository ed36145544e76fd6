"""Pictures into files: complete, correct, and never partial."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from codec.arrays import Bytes
from codec.errors import InvalidError
from player.show.sink import FolderSink, check_output, open_sink
from player.view.path import Size


def picture(seed: int, width_px: int, height_px: int) -> Bytes:
    """A smooth picture, because noise would lower the codec's quality."""
    rng = np.random.default_rng(seed)
    coarse = Image.fromarray(rng.integers(0, 256, (3, 4, 3)).astype(np.uint8))
    return np.asarray(coarse.resize((width_px, height_px), Image.Resampling.BICUBIC))


def break_off(path: Path, kind: type[BaseException]) -> None:
    """Writes two pictures, and then fails before the end."""
    with open_sink(path, 30.0, Size(32, 32)) as sink:
        for frame in (3, 4):
            sink.write(frame, picture(frame, 32, 32))
        raise kind("the drawing broke")


@pytest.mark.parametrize(("width_px", "height_px"), [(64, 48), (63, 47)])
def test_a_video_holds_every_frame_in_order(tmp_path: Path, width_px: int, height_px: int) -> None:
    path = tmp_path / "out.mp4"
    pictures = [picture(n, width_px, height_px) for n in range(12)]
    with open_sink(path, 25.0, Size(width_px, height_px)) as sink:
        for frame, image in enumerate(pictures, 30):
            sink.write(frame, image)
            assert not path.exists()
    assert list(tmp_path.iterdir()) == [path]
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.width, stream.height) == (64, 48)
        assert stream.average_rate == 25
        decoded = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(decoded) == 12
    for shown, expected in zip(decoded, pictures, strict=True):
        error = shown[:height_px, :width_px].astype(np.float64) - expected
        assert (error**2).mean() < 1e-3 * 255**2


def test_pngs_are_exact_and_named_by_frame(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "b"
    with open_sink(folder, 30.0, Size(9, 7)) as sink:
        for frame, shown in {7: picture(1, 9, 7), 123456: picture(2, 9, 7)}.items():
            sink.write(frame, shown)
    assert sorted(p.name for p in folder.iterdir()) == ["frame_00007.png", "frame_123456.png"]
    np.testing.assert_array_equal(
        np.asarray(Image.open(folder / "frame_00007.png")), picture(1, 9, 7)
    )


def test_what_a_failed_drawing_made_is_removed_and_only_that(tmp_path: Path) -> None:
    """Then the same command can be run again."""
    there, film = tmp_path / "there", tmp_path / "out.mp4"
    there.mkdir()
    (there / "notes.txt").write_text("of somebody")
    film.write_bytes(b"what was there before")
    for out in (tmp_path / "new", there, film):
        with pytest.raises(RuntimeError, match="the drawing broke"):
            break_off(out, RuntimeError)
        check_output(out)
    assert sorted(tmp_path.rglob("*")) == [film, there, there / "notes.txt"]
    assert film.read_bytes() == b"what was there before"
    with pytest.raises(KeyboardInterrupt):  # what a user ends stays
        break_off(there, KeyboardInterrupt)
    assert sorted(path.name for path in there.iterdir()) == [
        *("frame_00003.png", "frame_00004.png", "notes.txt")
    ]


def test_a_png_that_cannot_be_written_is_not_there(tmp_path: Path) -> None:
    sink = FolderSink(tmp_path / "out")
    (tmp_path / "out" / "frame_00001.png").mkdir()
    with pytest.raises(OSError, match="frame_00001"):
        sink.write(1, picture(1, 8, 8))
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["frame_00001.png"]


def test_outputs_that_cannot_be(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "frames").mkdir()
    (tmp_path / "frames" / "frame_00000.png").write_text("")
    (tmp_path / "dir.mp4").mkdir()
    for name, message in (
        ("x.mkv", "name an .mp4"),
        ("file", "is a file"),
        ("frames", "already contains frames"),
        ("dir.mp4", "is a folder"),
        ("absent/x.mp4", "there is no folder"),
    ):
        with pytest.raises(InvalidError, match=message):
            check_output(tmp_path / name)
