"""Pictures into files: a single PNG, a folder of them, or an .mp4.

Rule: a file under its final name is whole. What is being written has a temporary name.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Protocol

import av
import numpy as np
import numpy.typing as npt
from PIL import Image

from codec.arrays import Bytes, Floats
from codec.errors import InvalidError, SwingsError
from codec.files import DISK_ERRORS, replacing
from codec.stream.sound import SAMPLE_RATE
from player.playout.clock import exact_rate
from player.view.path import Size

Words = npt.NDArray[np.uint16]
Sound = npt.NDArray[np.int16]

Picture = Bytes | Words
"""(H, W, 3) uint8 RGB or (H, W, 4) RGBA, row 0 on top; or (H, W) grey of uint8 or uint16."""

VIDEO_SUFFIX = ".mp4"

OTHER_SUFFIXES = {
    *(".avi", ".exr", ".gif", ".jpeg", ".jpg", ".m4v", ".mkv", ".mov", ".png", ".webm")
}
"""Names that ask for something other than a folder."""


class SinkError(SwingsError):
    """The pictures cannot be written."""


class FrameSink(Protocol):
    """Takes pictures in frame order."""

    def write(self, frame: int, picture: Picture) -> None:
        """picture: in a video of colours."""
        ...

    def write_sound(self, samples: Sound) -> None:
        """Adds to the sound track, if there is one. samples: (n, 2) at codec.stream.sound's
        SAMPLE_RATE."""
        ...


def to_bytes(picture: Floats) -> Bytes:
    """A picture of 0..1 in 8 bits; what is brighter is clipped."""
    return np.rint(np.clip(picture, 0, 1) * 255).astype(np.uint8)


def write_picture(path: Path, picture: Picture) -> None:
    """Puts the picture at `path` as PNG, all of it or nothing."""
    with replacing(path) as temporary:
        Image.fromarray(picture).save(temporary, "PNG", compress_level=4)


def check_still(path: Path) -> None:
    """Raises InvalidError when no single picture can be written to `path`."""
    if path.suffix.lower() != ".png":
        raise InvalidError(f"{path}: a still is one picture; name a .png file")
    if path.is_dir():
        raise InvalidError(f"{path} is a folder")
    if not path.parent.is_dir():
        raise InvalidError(f"{path}: there is no folder {path.parent}")


def check_output(path: Path) -> None:
    """Raises InvalidError when no capture can be written to `path`."""
    if path.suffix.lower() in OTHER_SUFFIXES:
        raise InvalidError(f"{path}: name an .mp4 file, or a folder for PNGs")
    if path.suffix.lower() == VIDEO_SUFFIX:
        if path.is_dir():
            raise InvalidError(f"{path} is a folder")
        if not path.parent.is_dir():
            raise InvalidError(f"{path}: there is no folder {path.parent}")
    elif path.exists() and not path.is_dir():
        raise InvalidError(f"{path} is a file; name an .mp4 file, or a folder for PNGs")
    elif path.is_dir() and any(path.glob("frame_*.*")):
        raise InvalidError(f"{path} already contains frames; remove them or name another folder")


VIDEO_ENCODER, SOUND_ENCODER = "libx264", "aac"
PIXELS = "yuv420p"
"""Pixel format, as FFmpeg names it. Colours are BT.709."""
# Equal pictures should give equal files. x264's macroblock tree does not: with AVX-512 its bytes
# differ from run to run.
ENCODER_OPTIONS = {"crf": "16", "preset": "fast", "x264-params": "mbtree=0"}
"""Constant rate factor 16 is visually lossless."""

SOUND_BITRATE_BPS = 192000
"""Bitrate of the AAC track."""

# As FFmpeg numbers them.
_BT709 = 1
_LIMITED_RANGE = 1


@contextmanager
def open_sink(path: Path, fps: float, size: Size, *, sound: bool = False) -> Iterator[FrameSink]:
    """Gives what writes pictures of `size` to `path`, by its suffix. sound: a video gets a sound
    track of what `write_sound` is given; pictures in a folder have none.

    Leaving by an error leaves nothing, so that the same command can be given again. Ctrl-C leaves
    no video, but the pictures that are written.
    """
    check_output(path)
    if path.suffix.lower() != VIDEO_SUFFIX:
        pictures = FolderSink(path)
        try:
            yield pictures
        except Exception:
            pictures.remove()
            raise
        return
    with replacing(path) as temporary:
        video = VideoSink(path, temporary, fps, size, sound)
        try:
            yield video
            video.finish()
        finally:
            video.close()


class FolderSink:
    """frame_00000.png, frame_00001.png, ... by frame number."""

    def __init__(self, folder: Path) -> None:
        self._was_there = folder.exists()
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._written: list[Path] = []

    def write(self, frame: int, picture: Picture) -> None:
        path = self._folder / f"frame_{frame:05d}.png"
        write_picture(path, picture)
        self._written.append(path)

    def write_sound(self, samples: Sound) -> None:
        pass

    def remove(self) -> None:
        """Removes what was written, and the folder unless it was there before."""
        for path in self._written:
            path.unlink(missing_ok=True)
        if not self._was_there:
            with suppress(OSError):  # somebody else has put something into it
                self._folder.rmdir()


class VideoSink:
    """An .mp4: H.264 in 8 bits 4:2:0, and AAC. `finish` makes it whole; `close` in any case."""

    def __init__(
        self, path: Path, temporary: Path, fps: float, size: Size, sound: bool = False
    ) -> None:
        """path: what errors call it. temporary: what is written."""
        self._path = path
        # Both sides of a 4:2:0 picture are even: the last column or row is repeated.
        more_px = size.height_px % 2, size.width_px % 2
        self._padding = ((0, more_px[0]), (0, more_px[1]), (0, 0))
        self._container = av.open(str(temporary), "w", format="mp4")
        try:
            rate = exact_rate(fps)
            stream: av.VideoStream = self._container.add_stream(VIDEO_ENCODER, rate=rate)  # type: ignore[assignment]
            stream.width = size.width_px + more_px[1]
            stream.height = size.height_px + more_px[0]
            stream.pix_fmt = PIXELS
            stream.options = dict(ENCODER_OPTIONS)
            stream.codec_context.colorspace = _BT709
            stream.codec_context.color_primaries = _BT709
            stream.codec_context.color_trc = _BT709
            stream.codec_context.color_range = _LIMITED_RANGE
            self._track: av.AudioStream | None = None
            if sound:
                track: av.AudioStream = self._container.add_stream(  # type: ignore[assignment]
                    SOUND_ENCODER, rate=SAMPLE_RATE, layout="stereo"
                )
                track.bit_rate = SOUND_BITRATE_BPS
                self._track = track
        except Exception as error:  # PyAV lacks the encoder: ValueError, or an FFmpeg error
            self.close()
            raise SinkError(
                f"{path}: this PyAV has no encoder {VIDEO_ENCODER} or {SOUND_ENCODER}: {error}"
            ) from error
        self._stream = stream
        self._written = 0
        self._heard = 0  # samples

    def write(self, frame: int, picture: Picture) -> None:
        padded = np.pad(picture, self._padding, mode="edge")
        image = av.VideoFrame.from_ndarray(np.ascontiguousarray(padded), format="rgb24")
        image = image.reformat(format=PIXELS, dst_colorspace="ITU709")
        image.pts = self._written
        self._written += 1
        try:
            self._container.mux(self._stream.encode(image))
        except av.error.FFmpegError as error:
            raise self._failed(error, f"frame {frame}: ") from error

    def write_sound(self, samples: Sound) -> None:
        if self._track is None or not len(samples):
            return
        row = np.ascontiguousarray(samples).reshape(1, -1)
        frame = av.AudioFrame.from_ndarray(row, format="s16", layout="stereo")
        frame.sample_rate, frame.pts = SAMPLE_RATE, self._heard
        self._heard += len(samples)
        try:
            self._container.mux(self._track.encode(frame))
        except av.error.FFmpegError as error:
            raise self._failed(error, "sound: ") from error

    def finish(self) -> None:
        try:
            self._container.mux(self._stream.encode(None))
            if self._track is not None:
                self._container.mux(self._track.encode(None))
            self._container.close()
        except av.error.FFmpegError as error:
            raise self._failed(error) from error

    def _failed(self, error: av.error.FFmpegError, where: str = "") -> SinkError:
        if error.errno in DISK_ERRORS:
            return SinkError(f"{self._path} cannot be written: {error.strerror}")
        return SinkError(f"{self._path}: {where}{error}")

    def close(self) -> None:
        with suppress(av.error.FFmpegError):  # a full disk takes no trailer, and has been reported
            self._container.close()
