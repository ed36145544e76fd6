"""Masks beside a capture of any layout: a folder of numbered pictures for each camera.

    masks/<camera>/<number>.png     what masks.py says, one for each frame or one for all

The numbers may start anywhere but must not have a gap; the first is frame 0 of the capture.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

from codec.camera import Camera
from trainer.errors import CaptureError

from .camerachoice import ALL_CAMERAS, CameraChoice, named
from .lens import Lens
from .masks import MASKS_NAME, MaskFiles, mask_source
from .picturefiles import folder_names, frame_number, numbered_files

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
