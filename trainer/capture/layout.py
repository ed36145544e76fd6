"""Which layout a folder has."""

from __future__ import annotations

from pathlib import Path

from codec.storage.openstorage import Target
from trainer.errors import CaptureError
from trainer.storedfiles import by_its_name, local_folder, translated

from .capture import Capture
from .colmap import MODEL_NAME, open_colmap
from .dynamic3dgs import META_NAMES, open_dynamic3dgs
from .dynerf import POSES_NAME, VIDEO_PATTERN, open_dynerf
from .nerfstudio import open_nerfstudio
from .transforms import TRANSFORMS_NAME


def open_capture(target: Target) -> Capture:
    """The capture of a known layout in a folder or, by URL, in an object store.

    No picture is decoded yet. Raises CaptureError.
    """
    with translated():
        path = local_folder(target)
    with by_its_name(path):
        return _open_folder(path)


def _open_folder(path: Path) -> Capture:
    if not path.exists():
        raise CaptureError(f"{path}: no such folder")
    if not path.is_dir():
        raise CaptureError(f"{path}: not a folder; name the folder that holds the capture")
    names = sorted(entry.name for entry in path.iterdir())
    if not names:
        raise CaptureError(f"{path}: the folder is empty")
    if any(name in META_NAMES for name in names):
        return open_dynamic3dgs(path)
    if POSES_NAME in names:
        return open_dynerf(path)
    if TRANSFORMS_NAME in names:
        return open_nerfstudio(path)
    if MODEL_NAME in names:
        return open_colmap(path)
    if any(VIDEO_PATTERN.fullmatch(name) for name in names):
        return open_dynerf(path)  # says that the poses are missing
    raise CaptureError(
        f"{path}: unknown layout; expected {META_NAMES[0]} with ims/ (Dynamic 3D Gaussians), "
        f"camNN.mp4 files with {POSES_NAME} (DyNeRF), {TRANSFORMS_NAME} (Nerfstudio) "
        f"or {MODEL_NAME}/ with frames/ or images/ (COLMAP)"
    )
