"""Which pixels of a camera's pictures count: those that its lens shows, and of these the white ones
of mask files.

A mask file has the size of its picture as it is on disk, before straightening. A grey of 128 or
more counts as white.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from codec.camera import Camera
from trainer.errors import CaptureError
from trainer.pixels import opened_picture, read_grey

from .capture import Mask, check_frame
from .lens import Lens, folded_share, shows_all, straightened, unseen_pixels
from .picturefiles import folder_names

MASKS_NAME = "masks"
WHITE = 128
"""Least grey of a pixel that counts."""


@dataclass(frozen=True, slots=True)
class MaskFiles:
    """The masks of one camera. Holds nothing open: any thread may read."""

    camera: Camera
    lens: Lens
    files: tuple[Path, ...]
    """One for each frame, one for all, or none."""

    @property
    def is_still(self) -> bool:
        return len(self.files) <= 1

    @property
    def has_files(self) -> bool:
        return bool(self.files)

    @property
    def folded_share(self) -> float:
        return folded_share(self.camera, self.lens)

    def read(self, frame: int) -> Mask:
        if not self.files:
            return (~unseen_pixels(self.camera, self.lens)).astype(np.uint8)
        if self.is_still:
            frame = 0
        check_frame(frame, len(self.files), self.camera.name)
        path = self.files[frame]
        grey = read_grey(path, self._check_size)
        brightest = int(grey.max())
        if 0 < brightest < WHITE:
            raise CaptureError(
                f"{path}: its brightest pixel is {brightest} of 255; pixels count from {WHITE} on"
            )
        white = np.where(grey >= WHITE, np.uint8(255), np.uint8(0))
        if not self.lens.is_straight:
            white = straightened(np.stack([white] * 3, axis=2), self.camera, self.lens)[..., 0]
            white[unseen_pixels(self.camera, self.lens)] = 0
        # A straight pixel mixes up to four bent ones: below 255 an ignored one is among them.
        counts: Mask = (white == 255).astype(np.uint8)
        return counts

    def check_header(self) -> None:
        """Raises CaptureError if the first mask file has another size than the pictures."""
        with opened_picture(self.files[0], "mask", self._check_size):
            pass

    def _check_size(self, path: Path, size: tuple[int, int]) -> None:
        if size != (self.camera.width_px, self.camera.height_px):
            raise CaptureError(
                f"{path}: is {size[0]}x{size[1]} px; its picture has "
                f"{self.camera.width_px}x{self.camera.height_px} px"
            )


def mask_source(camera: Camera, lens: Lens, files: tuple[Path, ...]) -> MaskFiles | None:
    """The masks of one camera from a file per frame, one for all, or none; None where every pixel
    counts. Raises CaptureError if the first cannot be read or has another size than the
    pictures."""
    masks = MaskFiles(camera, lens, files if len(set(files)) > 1 else files[:1])
    if files:
        masks.check_header()
    elif shows_all(camera, lens):
        return None
    return masks


def mirrored_masks(
    masks: Path, pictures: Path, files: Sequence[Sequence[Path]]
) -> list[tuple[Path, ...]]:
    """For each camera's picture files, below `pictures`, the mask files below `masks`.

    The mask of a/b.jpg is a/b.jpg.png or a/b.png. A camera without masks gets (). Raises
    CaptureError if only some of a camera's pictures have a mask, or if the folder `masks` exists
    and has none for any camera.
    """
    if not masks.is_dir():
        return [() for _ in files]
    listed: dict[Path, frozenset[str]] = {}
    result: list[tuple[Path, ...]] = []
    for of_camera in files:
        found: list[Path] = []
        missing: list[Path] = []
        for file in of_camera:
            folder = masks / file.parent.relative_to(pictures)
            if folder not in listed:
                listed[folder] = folder_names(folder)
            names = (f"{file.name}.png", f"{file.stem}.png")
            name = next((name for name in names if name in listed[folder]), None)
            (missing if name is None else found).append(folder / (name or names[0]))
        if found and missing:
            raise CaptureError(
                f"{missing[0]}: is missing; a camera with masks needs one for every frame"
            )
        result.append(tuple(found))
    if not any(result):
        raise CaptureError(
            f"{masks}: has no mask of a picture in {pictures.name}/; name each as its picture "
            "with .png, or rename the folder"
        )
    return result
