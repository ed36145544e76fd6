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
    held_out.txt           optional, see held_out.py
    fps.txt                optional, see picturefiles.py

picturefiles.py says how frames are numbered. Pictures of cameras that the model does not have are
left out, and named. Pinhole models are taken as they are; pictures of SIMPLE_RADIAL, RADIAL and
OPENCV cameras are straightened as they are read; other models are refused. COLMAP's unit is taken
as a metre, and its points are the initial points.
"""

from __future__ import annotations

from pathlib import Path, PurePosixPath

import numpy as np

from codec.camera import Camera
from codec.errors import InvalidError
from codec.rig import rig_depths
from trainer.errors import CaptureError

from .camerachoice import ALL_CAMERAS, CameraChoice, named
from .capture import Capture, CaptureCamera, PictureSource
from .colmap_model import (
    Optics,
    Posed,
    find_model,
    read_model_points,
    read_optics,
    read_posed,
    rotation_of_posed,
)
from .held_out import read_held_out
from .lens import Lens, check_optics
from .maskfolders import folder_masks, has_mask_folders
from .masks import MASKS_NAME, MaskFiles, mask_source, mirrored_masks
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
from .points import points_depths


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
