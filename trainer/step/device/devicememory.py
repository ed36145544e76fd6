"""How much memory of a device a training takes, before it begins."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import torch

from codec.errors import InvalidError
from codec.splats import sh_count
from trainer.step.backend import MemoryNeeds

PIXEL_BYTES = 1100
"""Of a step for a pixel, most of it in the loss."""

GAUSSIAN_BYTES = 900
"""Of a step for a Gaussian, beside its parameters."""

ROW_COPIES = 9
"""Copies of a Gaussian's parameters in a step: gathered, joined, their gradients, updates."""

TILES_PER_GAUSSIAN = 8
"""Tiles that a Gaussian touches, a generous mean."""

PAIR_BYTES = 120
"""Of a step for a pair of a Gaussian and a tile."""

LEAST_PICTURES = 2
"""Pictures that a step must have room for."""


@dataclass(frozen=True, slots=True)
class MemoryPlan:
    """Bytes on the device."""

    gaussians_bytes: int
    """Parameters and histories."""
    step_bytes: int
    """Memory that a step takes and gives back."""
    pictures_bytes: int
    """The captured pictures that are kept."""

    @property
    def total_bytes(self) -> int:
        return self.gaussians_bytes + self.step_bytes + self.pictures_bytes

    def __str__(self) -> str:
        parts = (
            ("Gaussians", self.gaussians_bytes),
            ("step", self.step_bytes),
            ("pictures", self.pictures_bytes),
        )
        told = ", ".join(f"{name} {num_bytes / 1e9:.2f}" for name, num_bytes in parts)
        return f"{self.total_bytes / 1e9:.2f} GB ({told})"


def planned(
    needs: MemoryNeeds, free_bytes: int, batch_bytes: int, max_picture_bytes: int, where: str
) -> MemoryPlan:
    """The plan of a training on a device with `free_bytes`; pictures get what is left, within
    `max_picture_bytes`.

    batch_bytes: what the rasteriser takes beside pixels and pairs. Raises InvalidError, which
    names `where`, if the device has too little.
    """
    row_bytes = 4 * (11 + 3 * sh_count(needs.sh_degree))
    # Two generations; two histories and the counts of steps.
    gaussians = needs.num_gs * (4 * row_bytes + 4)
    step = needs.num_gs * (ROW_COPIES * row_bytes + GAUSSIAN_BYTES)
    step += needs.num_gs * TILES_PER_GAUSSIAN * PAIR_BYTES
    step += needs.pixels * PIXEL_BYTES + batch_bytes
    shot_bytes = needs.pixels * (4 if needs.has_masks else 3)
    left = free_bytes - gaussians - step
    least = MemoryPlan(gaussians, step, LEAST_PICTURES * shot_bytes)
    if left < least.pictures_bytes:
        raise InvalidError(
            f"{where} has {free_bytes / 1e9:.2f} GB free, and this training needs {least}; choose "
            "a smaller --num-gs, --sh-degree or --scale"
        )
    wanted = min(needs.shots * shot_bytes, max_picture_bytes)
    return MemoryPlan(gaussians, step, max(min(wanted, left), least.pictures_bytes))


def free_bytes(device: torch.device) -> int:
    """Memory of `device` that is not used."""
    if device.type == "cuda":
        return int(torch.cuda.mem_get_info(device)[0])
    if device.type == "xpu":
        return int(torch.xpu.mem_get_info(device)[0])
    if device.type == "mps":
        used: int = torch.mps.driver_allocated_memory()
        return int(torch.mps.recommended_max_memory()) - used
    return _free_host_bytes()


def _free_host_bytes() -> int:
    """On Linux what can be had without swapping; elsewhere all of the memory."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        return 1024 * next(int(n.split()[1]) for n in lines if n.startswith("MemAvailable:"))
    except (OSError, StopIteration, ValueError):
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
