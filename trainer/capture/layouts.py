"""The layouts that captures come in: a table. All that must know of every layout is made of it.

To add one, see docs/EXTENDING.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name

from .capture import CameraChoice, Capture


@dataclass(frozen=True, slots=True)
class CaptureLayout:
    """A row of the table."""

    name: str
    """`Capture.layout`."""
    title: str
    """What people call it."""
    contents: str
    """What a folder of it holds, for the error that names the known layouts."""
    markers: tuple[str, ...]
    """Names in a folder, any of which tells that it has this layout."""
    table_suffixes: tuple[str, ...]
    """Suffixes of its files that are read whole as a capture is opened: neither pictures nor
    videos. From an object store only these are copied."""
    opener: str
    """The function that opens a folder: (root, choice) -> Capture, as "module:function". It is
    imported when it is called, because `--help` must not wait for what decodes pictures."""

    def open(self, root: Path, choice: CameraChoice) -> Capture:
        """The chosen cameras of the capture in a folder of this layout. Raises CaptureError."""
        capture: Capture = resolve_name(self.opener)(root, choice)
        return capture


LAYOUTS = (
    CaptureLayout(
        "dynamic3dgs", "Dynamic 3D Gaussians", "train_meta.json with ims/",
        ("train_meta.json", "test_meta.json"), (".json",),
        "trainer.capture.dynamic3dgs:open_dynamic3dgs",
    ),
    CaptureLayout(
        "dynerf", "DyNeRF", "camNN.mp4 files with poses_bounds.npy",
        ("poses_bounds.npy",), (".npy",), "trainer.capture.dynerf:open_dynerf",
    ),
    CaptureLayout(
        "nerfstudio", "nerfstudio", "transforms.json",
        ("transforms.json",), (".json",), "trainer.capture.nerfstudio:open_nerfstudio",
    ),
    CaptureLayout(
        "colmap", "COLMAP", "sparse/ with frames/ or images/",
        ("sparse",), (".bin", ".txt"), "trainer.capture.colmap:open_colmap",
    ),
    CaptureLayout(
        "easymocap", "EasyMocap", "intri.yml and extri.yml with images/ or videos/",
        ("intri.yml", "extri.yml"), (".yml",), "trainer.capture.easymocap:open_easymocap",
    ),
)  # fmt: skip
"""In the order in which a folder is tried."""

COMMON_SUFFIXES = (".txt", ".npz", ".ply")
"""Suffixes of what any layout may have: fps.txt, held_out.txt, points."""

TABLE_SUFFIXES = frozenset(COMMON_SUFFIXES).union(*(row.table_suffixes for row in LAYOUTS))

TITLES = {row.name: row.title for row in LAYOUTS}


def listed_titles() -> str:
    """The titles in a sentence: A, B or C."""
    *others, last = TITLES.values()
    return f"{', '.join(others)} or {last}"
