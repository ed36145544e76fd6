"""Picture files to 8-bit pixels, and nothing else: what a file means otherwise is refused, not
guessed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from codec.arrays import Bytes
from codec.errors import CodecError

from .errors import CaptureError
from .storedfiles import by_its_name, opened_file

CheckSize = Callable[[Path, tuple[int, int]], None]
"""Raises CaptureError for a file whose (width, height) in pixels is wrong, before it is decoded."""

PLAIN_MODES = {"1", "L", "P", "RGB"}
"""Modes of Pillow with 8 bits a channel at most. A colour PNG of 16 bits is one of them, too:
Pillow gives the upper 8."""

BLACK = (0, 0, 0, 255)

ALPHA_MODES = {"LA", "La", "PA", "RGBA", "RGBa"}

DEEP_GREY_MODES = {"I;16", "I;16B", "I;16L", "I;16N"}

GREY_STEP = 257
"""Steps of 16-bit grey in one of 8 bits: 65535 / 255."""


@contextmanager
def opened_picture(path: Path, what: str, check_size: CheckSize) -> Iterator[Image.Image]:
    """The picture at `path`, of which only the header is read yet. Raises CaptureError, here and
    for what is done in the block; what: "picture" or "mask", for errors."""
    with ExitStack() as stack:
        stack.enter_context(by_its_name(path))
        try:
            file = stack.enter_context(opened_file(path))
        except CodecError as error:
            raise CaptureError(str(error)) from error
        try:
            image = stack.enter_context(Image.open(file))
            check_size(path, image.size)
            yield image
        except UnidentifiedImageError as error:
            raise CaptureError(f"{path}: not a {what} that can be read") from error
        except Image.DecompressionBombError as error:
            raise CaptureError(f"{path}: too large for a {what}: {error}") from error
        except (OSError, ValueError, SyntaxError) as error:
            raise CaptureError(f"{path}: not a {what} that can be read: {error}") from error


def read_rgb(path: Path, check_size: CheckSize) -> Bytes:
    """(H, W, 3) the picture at `path`.

    16-bit grey is rounded to 8 bits. What is transparent is laid on black, which is what a stream
    shows where it has no Gaussian. Raises CaptureError for anything that has no one meaning as
    8-bit RGB: CMYK, floats.
    """
    with opened_picture(path, "picture", check_size) as image:
        if _is_deep_grey(image):
            return np.repeat(_rounded(image)[..., None], 3, axis=2)
        if image.mode in ALPHA_MODES or "transparency" in image.info:
            whole = image.convert("RGBA")
            image = Image.alpha_composite(Image.new("RGBA", image.size, BLACK), whole)
        elif image.mode not in PLAIN_MODES:
            raise CaptureError(
                f"{path}: pixels of mode {image.mode} are not supported in a capture; "
                "save it as 8-bit RGB"
            )
        return np.array(image.convert("RGB"))


def read_grey(path: Path, check_size: CheckSize) -> Bytes:
    """(H, W) the mask at `path`; 16 bits are rounded to 8. Raises CaptureError."""
    with opened_picture(path, "mask", check_size) as image:
        return _rounded(image) if _is_deep_grey(image) else np.array(image.convert("L"))


def _is_deep_grey(image: Image.Image) -> bool:
    # Older Pillows call a PNG's 16 bits I; elsewhere I is 32 bits.
    return image.mode in DEEP_GREY_MODES or (image.mode == "I" and image.format == "PNG")


def _rounded(image: Image.Image) -> Bytes:
    """(H, W) of 16-bit grey, which Pillow itself would cut off at 255."""
    deep = np.asarray(image).astype(np.uint32)
    return ((deep + GREY_STEP // 2) // GREY_STEP).astype(np.uint8)
