"""Which pixels of a camera's pictures count: those that its lens shows, and of these the white ones
of mask files.

A mask file has the size of its picture as it is on disk, before straightening. A grey of 128 or
more counts as white. Captures of any layout may have masks in a folder for each camera:

    masks/<camera>/<number>.png     one for each frame, or one for all

The numbers may start anywhere but must not have a gap; the first is frame 0 of the capture.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from codec.camera import Camera
from trainer.errors import CaptureError
from trainer.pixels import opened_picture, read_grey

from .capture import ALL_CAMERAS, CameraChoice, Mask, check_frame, named
from .lens import Lens, folded_share, shows_all, straightened, unseen_pixels
from .picturefiles import folder_names, frame_number, numbered_files

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


SUFFIXES = frozenset({".png"})


def has_mask_folders(root: Path, cameras: Sequence[Camera]) -> bool:
    """Whether the capture has masks in a folder for each camera, named by number and not by the
    names of pictures."""
    names = [name for c in cameras for name in folder_names(root / MASKS_NAME / c.name)]
    return bool(names) and all(frame_number(Path(name).stem) is not None for name in names)


def folder_masks(
    root: Path,
    cameras: Sequence[Camera],
    lenses: Sequence[Lens],
    num_frames: int,
    choice: CameraChoice = ALL_CAMERAS,
    unposed: Collection[str] = (),
) -> list[MaskFiles | None]:
    """The masks of each camera; None for a camera without a folder whose lens shows every pixel.

    Masks of cameras that `choice` leaves out are passed over, and those of `unposed`, cameras that
    have pictures but no pose. Raises CaptureError if a folder is no camera's although it holds
    masks, or none is any camera's, if a mask is missing, or if the first of a camera has another
    size than its pictures.
    """
    folder = root / MASKS_NAME
    if not folder.is_dir():
        return [mask_source(c, lens, ()) for c, lens in zip(cameras, lenses, strict=True)]
    names = [camera.name for camera in cameras]
    folders = sorted(name for name in folder_names(folder) if (folder / name).is_dir())
    strange = [name for name in folders if name not in names and name not in unposed]
    strange = [name for name in strange if not choice.leaves_out(name)]
    if len(strange) < len(folders):  # beside masks of cameras, folders may hold anything else
        strange = [name for name in strange if _holds_masks(folder / name)]
    if strange:
        raise CaptureError(
            f"{folder / strange[0]}: is not the name of a camera ({named(names)}); masks are "
            f"{MASKS_NAME}/<camera>/<number>.png; rename it, or the folder {MASKS_NAME}"
        )
    return [
        mask_source(camera, lens, _files(folder / camera.name, num_frames))
        for camera, lens in zip(cameras, lenses, strict=True)
    ]


def _holds_masks(folder: Path) -> bool:
    files = map(Path, folder_names(folder))
    return any(frame_number(f.stem) is not None and f.suffix.lower() in SUFFIXES for f in files)


def _files(folder: Path, num_frames: int) -> tuple[Path, ...]:
    """The masks of a camera, a file per frame or one for all; none without the folder."""
    if not folder.is_dir():
        return ()
    files = numbered_files(folder, SUFFIXES)
    if len(files) not in (1, num_frames):
        raise CaptureError(
            f"{folder}: has {len(files)} masks, {files[0].name} to {files[-1].name}, for "
            f"{num_frames} frames; give one for each frame, or one for all"
        )
    return files
