"""Pictures into files: an .mp4, a .mov with alpha, or a folder of PNGs or OpenEXR files.

Rule: a file under its final name is whole. What is being written has a temporary name.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import av
import numpy as np

from codec.files import DISK_ERRORS, replacing
from codec.stream.sound import SAMPLE_RATE
from player.playout.outputtimes import exact_rate
from player.view.path import Size

from .sink import (
    EXR_SUFFIX,
    FrameSink,
    Picture,
    SinkError,
    Sound,
    check_output,
    write_picture,
)

VIDEO_CRF = 16
"""Constant rate factor of libx264: visually lossless."""


@dataclass(frozen=True, slots=True)
class VideoFormat:
    """How a kind of video file is encoded."""

    container: str
    encoder: str
    pixels: str
    """Pixel format, as FFmpeg names it."""
    picture: str
    """Format of the pictures that are written: rgb24 or rgba."""
    options: Mapping[str, str]
    multiple_px: int
    """Width and height are multiples of this: the last column or row is repeated."""
    sound: str
    """Encoder of the sound track."""


FORMATS = {
    # Equal pictures should give equal files. x264's macroblock tree does not: with AVX-512 its
    # bytes differ from run to run.
    ".mp4": VideoFormat(
        "mp4", "libx264", "yuv420p", "rgb24",
        {"crf": str(VIDEO_CRF), "preset": "fast", "x264-params": "mbtree=0"}, 2, "aac",
    ),
    ".mov": VideoFormat(
        "mov", "prores_ks", "yuva444p10le", "rgba", {"profile": "4444"}, 1, "pcm_s16le",
    ),
}  # fmt: skip
"""Video formats by suffix: .mp4 has H.264 in 8 bits 4:2:0 and AAC; .mov has ProRes 4444, which
keeps the alpha channel, and plain samples. Colours are BT.709."""

SOUND_BITRATE_BPS = 192000
"""Bitrate of the AAC track."""

# As FFmpeg numbers them.
_BT709 = 1
_LIMITED_RANGE = 1


@contextmanager
def open_sink(
    path: Path, fps: float, size: Size, *, sound: bool = False, exr: bool = False
) -> Iterator[FrameSink]:
    """Gives what writes pictures of `size` to `path`, by its suffix. sound: a video gets a sound
    track of what `write_sound` is given; pictures in a folder have none. exr: whether a folder gets
    OpenEXR files.

    Leaving by an error leaves nothing, so that the same command can be given again. Ctrl-C leaves
    no video, but the pictures that are written.
    """
    check_output(path)
    if path.suffix.lower() not in FORMATS:
        pictures = FolderSink(path, EXR_SUFFIX if exr else ".png")
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
    """frame_00000.png, frame_00001.png, ... by frame number; or .exr."""

    def __init__(self, folder: Path, suffix: str) -> None:
        self._suffix = suffix
        self._was_there = folder.exists()
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._written: list[Path] = []

    def write(self, frame: int, picture: Picture) -> None:
        path = self._folder / f"frame_{frame:05d}{self._suffix}"
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
    """A video of FORMATS. `finish` makes it whole; `close` in any case."""

    def __init__(
        self, path: Path, temporary: Path, fps: float, size: Size, sound: bool = False
    ) -> None:
        """path: what errors call it. temporary: what is written."""
        self._path = path
        self._format = form = FORMATS[path.suffix.lower()]
        more_px = -size.height_px % form.multiple_px, -size.width_px % form.multiple_px
        self._padding = ((0, more_px[0]), (0, more_px[1]), (0, 0))
        self._container = av.open(str(temporary), "w", format=form.container)
        try:
            rate = exact_rate(fps)
            stream: av.VideoStream = self._container.add_stream(form.encoder, rate=rate)  # type: ignore[assignment]
            stream.width = size.width_px + more_px[1]
            stream.height = size.height_px + more_px[0]
            stream.pix_fmt = form.pixels
            stream.options = dict(form.options)
            stream.codec_context.colorspace = _BT709
            stream.codec_context.color_primaries = _BT709
            stream.codec_context.color_trc = _BT709
            stream.codec_context.color_range = _LIMITED_RANGE
            self._track: av.AudioStream | None = None
            if sound:
                track: av.AudioStream = self._container.add_stream(  # type: ignore[assignment]
                    form.sound, rate=SAMPLE_RATE, layout="stereo"
                )
                if form.sound == "aac":
                    track.bit_rate = SOUND_BITRATE_BPS
                self._track = track
        except Exception as error:  # PyAV lacks the encoder: ValueError, or an FFmpeg error
            self.close()
            raise SinkError(
                f"{path}: this PyAV has no encoder {form.encoder} or {form.sound}: {error}"
            ) from error
        self._stream = stream
        self._written = 0
        self._heard = 0  # samples

    def write(self, frame: int, picture: Picture) -> None:
        form = self._format
        padded = np.pad(picture, self._padding, mode="edge")
        if form.picture == "rgba" and padded.shape[2] == 3:
            padded = np.pad(padded, ((0, 0), (0, 0), (0, 1)), constant_values=255)
        image = av.VideoFrame.from_ndarray(np.ascontiguousarray(padded), format=form.picture)
        image = image.reformat(format=form.pixels, dst_colorspace="ITU709")
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
