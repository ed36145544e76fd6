"""A grey picture of floats as an OpenEXR file, by FFmpeg's encoder."""

from __future__ import annotations

from fractions import Fraction

import av
import numpy as np
import numpy.typing as npt

from codec.errors import SwingsError


class ExrError(SwingsError):
    """The picture cannot be encoded."""


def encode_exr(picture: npt.NDArray[np.float32]) -> bytes:
    """An OpenEXR file with the (H, W) float32 `picture` as its only channel, Y, in 32-bit floats,
    compressed without loss. Raises ExrError where this PyAV lacks the encoder."""
    height_px, width_px = picture.shape
    try:
        encoder = av.CodecContext.create("exr", "w")
        assert isinstance(encoder, av.VideoCodecContext)
        encoder.width, encoder.height = width_px, height_px
        encoder.pix_fmt, encoder.time_base = "grayf32le", Fraction(1)
        encoder.options = {"compression": "zip16", "format": "float"}
        image = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="grayf32le")
        image.pts = 0
        return b"".join(map(bytes, [*encoder.encode(image), *encoder.encode(None)]))
    except (ValueError, av.error.FFmpegError) as error:
        raise ExrError(f"OpenEXR: this PyAV cannot encode it: {error}") from error
