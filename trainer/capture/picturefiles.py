"""Picture files of many cameras and frames, in the two folder layouts that people use.

    frames/<frame>/<picture>        a folder per frame; a camera's picture has one name in all
    images/<camera>/<frame>.jpg     a folder per camera; also .jpeg, .png, .webp, .tif and .tiff

<frame> ends in a number ("000012", "frame_12"). The numbers may start anywhere but must not have a
gap, and every camera has the same ones; the first is frame 0 of the capture. Pictures have no
frame rate; fps.txt beside them may, in frames per second.

A picture has 8 or 16 bits a channel; of 16 the upper 8 are taken. One that is transparent in places
is laid on black, which is what a stream shows where it has no Gaussian.
"""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from codec.camera import Camera
from codec.sequence.survey import FPS_NAME
from trainer.errors import CaptureError
from trainer.pixels import opened_picture, read_rgb

from .capture import Picture, PictureSource, check_fps, check_frame
from .lens import Lens, straight_source

FRAMES_NAME = "frames"
IMAGES_NAME = "images"
PICTURE_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff"})

_LAST_NUMBER = re.compile(r"(?:.*\D)?(\d{1,18})")


def frame_number(stem: str) -> int | None:
    """The number that a name without suffix ends in; None if it does not end in one."""
    found = _LAST_NUMBER.fullmatch(stem)
    return int(found[1]) if found else None


def natural_order(name: str) -> tuple[tuple[int, str], ...]:
    """A key that sorts cam2 before cam10."""
    return tuple(
        (int(part), "") if part.isdecimal() else (-1, part)
        for part in re.split(r"(\d{1,18})", name)
        if part
    )


def safe_path(text: str, declared_in: Path) -> PurePosixPath:
    """The relative path in `text`, which may be one of Windows. Raises CaptureError if it leads out
    of the capture."""
    path = PurePosixPath(text.replace("\\", "/"))
    if not path.parts or path.is_absolute() or ".." in path.parts or not text.isprintable():
        raise CaptureError(f"{declared_in}: {text!r} is not a path inside the capture")
    return path


def pictures_by_frame(folder: Path, names: Sequence[PurePosixPath]) -> list[tuple[Path, ...]]:
    """For each name, its files in the folders of `folder`, frame by frame.

    Raises CaptureError if a frame or a file is missing.
    """
    found: dict[int, Path] = {}
    for name, is_folder in _listing(folder).items():
        number = frame_number(name)
        if is_folder and number is not None:
            _add(found, number, folder / name)
    frames = _without_gap(found, folder)
    pictures = [tuple(frame / name for frame in frames) for name in names]
    require_files(pictures)
    return pictures


def pictures_by_camera(folders: Sequence[Path]) -> list[tuple[Path, ...]]:
    """For each camera's folder, its files, frame by frame.

    Raises CaptureError if a folder or a frame is missing.
    """
    pictures: list[tuple[Path, ...]] = []
    first: dict[int, Path] = {}
    for folder in folders:
        if not folder.is_dir():
            raise CaptureError(f"{folder}: is missing; a camera's numbered pictures belong there")
        found = _numbered(folder, PICTURE_SUFFIXES)
        first = first or found
        odd = sorted(found.keys() ^ first.keys())
        if odd and found:
            lacking, having = (folder, folders[0]) if odd[0] in first else (folders[0], folder)
            raise CaptureError(f"{lacking}: lacks frame {odd[0]}, which {having} has")
        pictures.append(tuple(_without_gap(found, folder)))
    return pictures


def numbered_files(folder: Path, suffixes: Collection[str]) -> tuple[Path, ...]:
    """The numbered files with one of the suffixes in a folder, in order of number.

    Raises CaptureError if there is none, if two have one number or if one is missing between
    others.
    """
    return tuple(_without_gap(_numbered(folder, suffixes), folder))


def _numbered(folder: Path, suffixes: Collection[str]) -> dict[int, Path]:
    found: dict[int, Path] = {}
    for name in _listing(folder):
        number = frame_number(Path(name).stem)
        if number is not None and Path(name).suffix.lower() in suffixes:
            _add(found, number, folder / name)
    return found


def require_files(
    pictures: Sequence[Sequence[Path]], reason: str = "every frame needs a picture per camera"
) -> None:
    """Raises CaptureError, giving the reason, for the first file that is missing. Each folder is
    listed once."""
    listed: dict[Path, dict[str, bool]] = {}
    for file in (file for files in pictures for file in files):
        if file.parent not in listed:
            listed[file.parent] = _listing(file.parent)
        if file.name not in listed[file.parent]:
            raise CaptureError(f"{file}: is missing; {reason}")


def check_without_gap(numbers: Collection[int], place: Path) -> None:
    """Raises CaptureError, naming `place`, if a number between first and last is missing."""
    ordered = sorted(numbers)
    for number, expected in zip(ordered, range(ordered[0], ordered[-1] + 1), strict=False):
        if number != expected:
            raise CaptureError(f"{place}: frame {expected} is missing before frame {number}")


@dataclass(frozen=True, slots=True)
class FileSource:
    """Pictures of one camera, a file per frame. Holds nothing open: any thread may read."""

    camera: Camera
    files: tuple[Path, ...]
    declared_in: Path
    """The file that declares the pictures' size."""

    def read(self, frame: int) -> Picture:
        check_frame(frame, len(self.files), self.camera.name)
        return read_rgb(self.files[frame], self._check_size)

    def close(self) -> None:
        """Nothing to free."""

    def check_header(self) -> None:
        """Raises CaptureError if the first picture has another size than declared; later ones are
        checked when they are read."""
        with opened_picture(self.files[0], "picture", self._check_size):
            pass

    def _check_size(self, path: Path, size: tuple[int, int]) -> None:
        if size != (self.camera.width_px, self.camera.height_px):
            raise CaptureError(
                f"{path}: is {size[0]}x{size[1]} px; {self.declared_in.name} declares "
                f"{self.camera.width_px}x{self.camera.height_px} px"
            )


def read_fps(root: Path) -> float | None:
    """The frames per second in fps.txt; None without the file. Raises CaptureError."""
    path = root / FPS_NAME
    if not path.is_file():
        return None
    try:
        fps = float(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise CaptureError(f"{path}: not a number of frames per second") from error
    check_fps(fps, path)
    return fps


def picture_source(
    camera: Camera, lens: Lens, files: tuple[Path, ...], declared_in: Path
) -> PictureSource:
    """The source of one camera. Raises CaptureError if the first picture has another size than
    `declared_in` says."""
    source = FileSource(camera, files, declared_in)
    source.check_header()
    return straight_source(source, camera, lens)


def folder_names(folder: Path) -> frozenset[str]:
    """The names in a folder, hidden ones left out; empty if there is no such folder."""
    return frozenset(_listing(folder))


def _listing(folder: Path) -> dict[str, bool]:
    """The names in a folder, hidden ones left out, and whether each is a folder; empty if there is
    no such folder."""
    try:
        with os.scandir(folder) as entries:
            return {e.name: e.is_dir() for e in entries if not e.name.startswith(".")}
    except (FileNotFoundError, NotADirectoryError):
        return {}


def _add(found: dict[int, Path], number: int, path: Path) -> None:
    if number in found:
        raise CaptureError(f"{path}: frame {number} is also {found[number].name}; remove one")
    found[number] = path


def _without_gap(found: dict[int, Path], folder: Path) -> list[Path]:
    if not found:
        raise CaptureError(f"{folder}: holds no numbered frames")
    check_without_gap(found, folder)
    return [found[number] for number in sorted(found)]
