"""The COLMAP layout: a sparse model of one frame's images, and the pictures of all frames.

    sparse/0/ or sparse/   cameras, images and points3D, each .bin or .txt; one image per camera.
                           Of sparse/0/, sparse/1/ and so on the largest is taken
    and the pictures, the first of these that exists:
    frames/<frame>/<image name>   a folder per frame, the images named as in the model; a camera
                           has the name of its image without suffix ("cam00.png": cam00)
    images/<camera>/<frame>.jpg   a folder per camera, .jpg, .png or the like; the model's image is
                           named <camera>.png or, as COLMAP names it itself, <camera>/<frame>.png
    masks/                 optional, see masks.py; mirrors frames/ or images/ as COLMAP has it: the
                           mask of <frame>/<image name> is masks/<frame>/<image name>.png, or has
                           .png in place of the picture's suffix. Without a mask every pixel of a
                           camera counts
    held_out.txt           optional, see capture.py
    fps.txt                optional, see picturefiles.py

picturefiles.py says how frames are numbered. Pictures of cameras that the model does not have are
left out, and named. Pinhole models are taken as they are; pictures of SIMPLE_RADIAL, RADIAL and
OPENCV cameras are straightened as they are read; other models are refused. COLMAP's unit is taken
as a metre, and its points are the initial points.

Each of a model's three files is binary (.bin, little endian) or text (.txt); the binary one is read
if there are both. What they say of matches (2D points, tracks) is passed over.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np

from codec.arrays import Doubles
from codec.camera import Camera, rotation_of
from codec.errors import InvalidError
from codec.rig import rig_depths
from trainer.errors import CaptureError

from .capture import (
    ALL_CAMERAS,
    CameraChoice,
    Capture,
    CaptureCamera,
    InitialPoints,
    PictureSource,
    named,
    read_held_out,
)
from .lens import Lens, check_optics
from .masks import (
    MASKS_NAME,
    MaskFiles,
    folder_masks,
    has_mask_folders,
    mask_source,
    mirrored_masks,
)
from .picturefiles import (
    FRAMES_NAME,
    IMAGES_NAME,
    PICTURE_SUFFIXES,
    folder_names,
    natural_order,
    picture_source,
    pictures_by_camera,
    pictures_by_frame,
    read_fps,
    safe_path,
)
from .points import checked_points, points_depths

MODELS = (
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
)
"""Name and number of parameters of COLMAP's camera models, by their number in binary files."""

_PARAMETERS = dict(MODELS)
_DECLARED_COUNT = re.compile(r"#\s*Number of (?:cameras|images|points):\s*(\d+)")


@dataclass(frozen=True, slots=True)
class Optics:
    """A row of the cameras file."""

    model: str
    width_px: int
    height_px: int
    parameters: tuple[float, ...]
    """As many as the model has, pixels and distortion terms in COLMAP's order."""


@dataclass(frozen=True, slots=True)
class Posed:
    """A row of the images file."""

    name: str
    """Path of the image below the folder that COLMAP was given."""
    optics_id: int
    quaternion: tuple[float, ...]
    """(w, x, y, z) the rotation from world to camera."""
    translation: tuple[float, ...]
    """World to camera, in the model's unit."""


def find_model(root: Path) -> tuple[Path, list[str]]:
    """The folder of the model of a capture, and a line about others that are not read.

    Where COLMAP cannot join all pictures it writes several models, 0/, 1/ and so on, in no order
    of size: the one with the most images is taken, and the first of equals. Raises CaptureError.
    """
    place = root / "sparse"
    numbered = (folder for folder in place.glob("*") if folder.name.isdecimal())
    models = [
        folder
        for folder in (*sorted(numbered, key=lambda folder: int(folder.name)), place)
        if any((folder / f"cameras{suffix}").is_file() for suffix in (".bin", ".txt"))
    ]
    if not models:
        raise CaptureError(f"{place}: neither it nor 0/ in it has cameras.bin or cameras.txt")
    if len(models) == 1:
        return models[0], []
    images = {folder: len(read_posed(folder)[1]) for folder in models if folder != place}
    chosen = max(images, key=lambda folder: images[folder])
    others = [f"{f.name} ({count})" for f, count in images.items() if f != chosen]
    if not others:
        return chosen, []
    return chosen, [
        f"{len(images)} models in {place.name}/: {chosen.name}, which has the most images "
        f"({images[chosen]}), is read, and {named(others)} is not; COLMAP could not join them"
    ]


def read_optics(folder: Path) -> tuple[Path, dict[int, Optics]]:
    """The file of cameras in a model folder and what it says, by id. Raises CaptureError."""
    path = _choose(folder, "cameras")
    rows = _optics_of_binary(path) if path.suffix == ".bin" else _optics_of_text(path)
    found: dict[int, Optics] = {}
    for key, optics in rows:
        if key in found:
            raise CaptureError(f"{path}: camera {key} is listed twice")
        found[key] = optics
    return path, found


def read_posed(folder: Path) -> tuple[Path, list[Posed]]:
    """The file of images in a model folder and what it says. Raises CaptureError."""
    path = _choose(folder, "images")
    rows = list(_posed_of_binary(path) if path.suffix == ".bin" else _posed_of_text(path))
    if not rows:
        raise CaptureError(f"{path}: has no images; the reconstruction failed")
    return path, rows


def read_model_points(folder: Path) -> InitialPoints | None:
    """The points of a model folder; None without a file of points or if it is empty. Raises
    CaptureError."""
    if not any((folder / f"points3D{suffix}").is_file() for suffix in (".bin", ".txt")):
        return None
    path = _choose(folder, "points3D")
    rows = list(_points_of_binary(path) if path.suffix == ".bin" else _points_of_text(path))
    if not rows:
        return None
    table = np.array(rows, np.float64)
    if not ((table[:, 3:] >= 0) & (table[:, 3:] <= 255)).all():
        raise CaptureError(f"{path}: a colour is not within 0..255")
    return checked_points(path, table[:, :3], table[:, 3:].astype(np.uint8))


def rotation_of_posed(posed: Posed, path: Path) -> Doubles:
    """(3, 3) the rotation from world to camera. Raises CaptureError, naming `path`, where the
    quaternion is not of unit length."""
    norm = math.hypot(*posed.quaternion)
    if not abs(norm - 1) < 1e-2:
        raise CaptureError(f"{path}: image {posed.name}: its quaternion has length {norm:g}, not 1")
    return rotation_of(np.asarray(posed.quaternion) / norm)


def _choose(folder: Path, stem: str) -> Path:
    for suffix in (".bin", ".txt"):
        if (folder / f"{stem}{suffix}").is_file():
            return folder / f"{stem}{suffix}"
    raise CaptureError(f"{folder / stem}.bin: is missing, and so is {stem}.txt")


class _Bytes:
    """A binary file, read front to back."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._data = path.read_bytes()
        except OSError as error:
            raise CaptureError(f"{path}: cannot be read: {error.strerror}") from error
        self._at = 0

    def take(self, layout: struct.Struct) -> tuple[int | float, ...]:
        """The next values."""
        start = self._skip(layout.size)
        return layout.unpack_from(self._data, start)

    def pass_over(self, count: int, size: int) -> None:
        """Skips `count` rows of `size` bytes."""
        self._skip(count * size)

    def name(self) -> str:
        """The text up to the next zero byte."""
        end = self._data.find(b"\0", self._at)
        start = self._skip((end if end >= 0 else len(self._data)) + 1 - self._at)
        try:
            return self._data[start:end].decode("utf-8")
        except UnicodeDecodeError as error:
            raise CaptureError(f"{self.path}: the name at byte {start} is not text") from error

    def end(self) -> None:
        """Raises CaptureError unless all is read."""
        if self._at != len(self._data):
            raise CaptureError(
                f"{self.path}: {len(self._data) - self._at} bytes follow the last row that it "
                "declares; export the model again"
            )

    def _skip(self, size: int) -> int:
        start = self._at
        if start + size > len(self._data):
            raise CaptureError(
                f"{self.path}: ends in the middle of a row, after {len(self._data)} bytes; "
                "the file is cut, copy it again"
            )
        self._at += size
        return start


_COUNT = struct.Struct("<Q")
_OPTICS = struct.Struct("<iiQQ")
_POSED = struct.Struct("<i7di")
_POINT = struct.Struct("<Q3d3Bd")


def _optics_of_binary(path: Path) -> Iterator[tuple[int, Optics]]:
    data = _Bytes(path)
    for _ in range(int(data.take(_COUNT)[0])):
        key, model, width, height = (int(x) for x in data.take(_OPTICS))
        if not 0 <= model < len(MODELS):
            raise CaptureError(f"{path}: camera {key} has the unknown model number {model}")
        name, number = MODELS[model]
        yield key, Optics(name, width, height, data.take(struct.Struct(f"<{number}d")))
    data.end()


def _posed_of_binary(path: Path) -> Iterator[Posed]:
    data = _Bytes(path)
    for _ in range(int(data.take(_COUNT)[0])):
        _, *pose, optics_id = data.take(_POSED)
        name = data.name()
        data.pass_over(int(data.take(_COUNT)[0]), 24)
        yield Posed(name, int(optics_id), tuple(pose[:4]), tuple(pose[4:]))
    data.end()


def _points_of_binary(path: Path) -> Iterator[tuple[float, ...]]:
    data = _Bytes(path)
    for _ in range(int(data.take(_COUNT)[0])):
        row = data.take(_POINT)
        data.pass_over(int(data.take(_COUNT)[0]), 8)
        yield row[1:7]
    data.end()


class _Lines:
    """A text file's lines with their numbers. At the end it is checked that there were as many rows
    as the header declares."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._lines = path.read_text(encoding="utf-8").split("\n")
        except (OSError, UnicodeDecodeError) as error:
            raise CaptureError(f"{path}: not text: {error}") from error

    def rows(self, with_second: bool = False) -> Iterator[tuple[int, str]]:
        """The lines that are neither empty nor comments. with_second: each of them has a second
        line, which is passed over even if it is empty."""
        declared, count, number = None, 0, 0
        while number < len(self._lines):
            line = self._lines[number].strip()
            number += 1
            if line.startswith("#"):
                found = _DECLARED_COUNT.match(line)
                declared = int(found[1]) if found else declared
            elif line:
                yield number, line
                count += 1
                number += with_second
        if declared not in (None, count):
            raise CaptureError(f"{self.path}: declares {declared} rows, has {count}; is it cut?")

    def bad(self, number: int, expected: str) -> CaptureError:
        return CaptureError(f"{self.path}: line {number} is not {expected!r}")


def _optics_of_text(path: Path) -> Iterator[tuple[int, Optics]]:
    lines = _Lines(path)
    for number, line in lines.rows():
        words = line.split()
        try:
            key, model, width, height = int(words[0]), words[1], int(words[2]), int(words[3])
            parameters = tuple(float(word) for word in words[4:])
        except (ValueError, IndexError) as error:
            raise lines.bad(number, "id MODEL width height parameters...") from error
        if len(parameters) != _PARAMETERS.get(model, len(parameters)):
            raise CaptureError(
                f"{path}: line {number}: {model} has {_PARAMETERS[model]} parameters, "
                f"not {len(parameters)}"
            )
        yield key, Optics(model, width, height, parameters)


def _posed_of_text(path: Path) -> Iterator[Posed]:
    lines = _Lines(path)
    for number, line in lines.rows(with_second=True):
        words = line.split(maxsplit=9)
        try:
            pose = [float(word) for word in words[1:8]]
            yield Posed(words[9], int(words[8]), tuple(pose[:4]), tuple(pose[4:]))
        except (ValueError, IndexError) as error:
            raise lines.bad(number, "id qw qx qy qz tx ty tz camera name") from error


def _points_of_text(path: Path) -> Iterator[tuple[float, ...]]:
    lines = _Lines(path)
    for number, line in lines.rows():
        words = line.split(maxsplit=7)
        try:
            yield tuple(float(words[i]) for i in range(1, 7))
        except (ValueError, IndexError) as error:
            raise lines.bad(number, "id x y z r g b ...") from error


def open_colmap(root: Path, choice: CameraChoice = ALL_CAMERAS) -> Capture:
    """The chosen cameras of the capture in a folder of this layout. Raises CaptureError."""
    model, doubts = find_model(root)
    by_frame = (root / FRAMES_NAME).is_dir()
    if not by_frame and not (root / IMAGES_NAME).is_dir():
        raise CaptureError(
            f"{root / FRAMES_NAME}: is missing, and so is {IMAGES_NAME}/; the pictures belong there"
        )
    optics_path, found = cameras_of_model(model, by_frame)
    names = choice.keep(found, root)
    cameras = [found[name][0] for name in names]
    pictures = root / (FRAMES_NAME if by_frame else IMAGES_NAME)
    if by_frame:
        files = pictures_by_frame(pictures, [found[name][2] for name in names])
    else:
        files = pictures_by_camera([pictures / _folder(found[name][2]) for name in names])
    sources = [
        picture_source(camera, found[name][1], of_camera, optics_path)
        for name, camera, of_camera in zip(names, cameras, files, strict=True)
    ]
    lenses = [found[name][1] for name in names]
    posed = found if by_frame else {_folder(path).parts[0] for _, _, path in found.values()}
    filmed = _filmed(files[0][0].parent, pictures, by_frame)
    unposed = [name for name in filmed if name not in posed]
    if unposed:
        doubts.append(
            f"pictures without a pose: those of {named(unposed)} are left out, as COLMAP did not "
            "place them"
        )
    masks: list[MaskFiles | None]
    if has_mask_folders(root, cameras):
        masks = folder_masks(root, cameras, lenses, len(files[0]), choice, unposed)
    else:
        mirrored = mirrored_masks(root / MASKS_NAME, pictures, files)
        masks = list(map(mask_source, cameras, lenses, mirrored))
    held_out = read_held_out(root, cameras, choice)
    points = read_model_points(model)
    depths = rig_depths(cameras, points_depths(points, cameras) if points else None)

    def open_images(camera_index: int) -> PictureSource:
        return sources[camera_index]

    return Capture(
        root=root,
        layout="colmap",
        cameras=tuple(
            CaptureCamera(camera, camera.name in held_out, of_camera)
            for camera, of_camera in zip(cameras, masks, strict=True)
        ),
        num_frames=len(files[0]),
        fps=read_fps(root),
        points=points,
        near_m=depths[0] if depths else None,
        far_m=depths[1] if depths else None,
        opener=open_images,
        doubts=tuple(doubts),
    )


def _filmed(frame: Path, pictures: Path, by_frame: bool) -> list[str]:
    """The names of the cameras that have pictures. frame: a folder of pictures."""
    if by_frame:
        files = [Path(name) for name in folder_names(frame)]
        found = [file.stem for file in files if file.suffix.lower() in PICTURE_SUFFIXES]
    else:
        found = [name for name in folder_names(pictures) if (pictures / name).is_dir()]
    return sorted(found, key=natural_order)


def cameras_of_model(
    model: Path, by_frame: bool = False
) -> tuple[Path, dict[str, tuple[Camera, Lens, PurePosixPath]]]:
    """The file of cameras in a model folder; and camera, lens and image of each camera, by name, in
    natural order.

    by_frame: whether images are named <camera>.png in a folder of their frame. Raises CaptureError.
    """
    optics_path, optics = read_optics(model)
    posed_path, images = read_posed(model)
    found: dict[str, tuple[Camera, Lens, PurePosixPath]] = {}
    for image in images:
        path = safe_path(image.name, posed_path)
        name = _camera_name(path, by_frame)
        if name in found:
            raise CaptureError(
                f"{posed_path}: {image.name} and {found[name][2]} are both camera {name}; "
                "a model must hold one frame, one image per camera"
            )
        if image.optics_id not in optics:
            raise CaptureError(
                f"{posed_path}: image {image.name} names camera {image.optics_id}, "
                f"which {optics_path.name} does not have"
            )
        camera, lens = _camera(name, optics[image.optics_id], image, optics_path, posed_path)
        found[name] = camera, lens, path
    return optics_path, {name: found[name] for name in sorted(found, key=natural_order)}


def pinhole_and_lens(optics: Optics) -> tuple[tuple[float, float, float, float], Lens] | None:
    """(fx, fy, cx, cy) in pixels and the distortion; None for a model that is not read."""
    p = optics.parameters
    match optics.model:
        case "SIMPLE_PINHOLE":
            return (p[0], p[0], p[1], p[2]), Lens()
        case "PINHOLE":
            return (p[0], p[1], p[2], p[3]), Lens()
        case "SIMPLE_RADIAL":
            return (p[0], p[0], p[1], p[2]), Lens(k1=p[3])
        case "RADIAL":
            return (p[0], p[0], p[1], p[2]), Lens(k1=p[3], k2=p[4])
        case "OPENCV":
            return (p[0], p[1], p[2], p[3]), Lens(k1=p[4], k2=p[5], p1=p[6], p2=p[7])
    return None


def _camera(
    name: str, optics: Optics, image: Posed, optics_path: Path, posed_path: Path
) -> tuple[Camera, Lens]:
    read = pinhole_and_lens(optics)
    if read is None:
        raise CaptureError(
            f"{optics_path}: camera {name} has the lens model {optics.model}; "
            "undistort the images with COLMAP first"
        )
    (fx, fy, cx, cy), lens = read
    w2c = np.eye(4)
    w2c[:3, :3] = rotation_of_posed(image, posed_path)
    w2c[:3, 3] = image.translation
    try:
        camera = Camera(name, optics.width_px, optics.height_px, fx, fy, cx, cy, w2c)
    except InvalidError as error:
        raise CaptureError(f"{optics_path}: {error}") from error
    check_optics(camera, lens, optics_path)
    return camera, lens


def _camera_name(image: PurePosixPath, by_frame: bool) -> str:
    return "_".join((image.with_suffix("") if by_frame else _folder(image)).parts)


def _folder(image: PurePosixPath) -> PurePosixPath:
    """The folder below images/ of a model's image."""
    return image.parent if len(image.parts) > 1 else image.with_suffix("")
