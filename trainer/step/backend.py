"""Where the Gaussians in training live, and where their steps are computed: in host memory, or on a
device of torch.

A backend starts a resident for a training. The resident holds parameters, their histories, the
cameras' colours and pictures; a step is a handful of numbers that is sent to it. The host's arrays
are filled by `Resident.fetch`, and what the host changes in them is passed on by `Resident.send`:
both only where a window begins or ends, or where Gaussians are relocated.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
import numpy.typing as npt

from codec.arrays import Floats, Ints
from trainer.pictures.framecache import Pictures
from trainer.pictures.scale import Shot

from .colour import CameraColour
from .loss import Loss
from .optimiser import Adam, CameraSpread
from .raster import Parameters, View

BackendName = Literal["auto", "cpu", "cuda", "torch"]


@dataclass(frozen=True, slots=True)
class StepInput:
    """The input of loss and gradients: what is rendered, and compared with."""

    values: Parameters
    rows: Ints
    """Indices of the Gaussians that are rendered."""
    view: View
    shot: Shot
    """The captured picture, of the view's size."""
    gain: Floats
    """(3,) factors of the camera's colours."""
    bias: Floats
    """(3,) added to the camera's colours."""
    trainable: int
    """Rows below this one get gradients."""
    whole: bool = True
    """Whether the loss covers all of the picture. Otherwise a backend may leave out what does not
    matter to the gradients, which are the same, and give a loss as of some tiles, see `Loss`."""


@dataclass(frozen=True, slots=True)
class Training:
    """A training in host memory: R = 2 num_gs rows of Gaussians, of which the first half is
    trained, and what they are compared with."""

    values: Parameters
    adam: Adam
    colour: CameraColour
    pictures: Pictures
    views: Sequence[View]
    """One for each camera."""
    half_views: Sequence[View]
    """The same for pictures of half the size; empty if there are none."""
    spread: CameraSpread
    dead_opacity: float
    """Opacity at which the noise is halved, see `add_noise`."""

    @property
    def num_gs(self) -> int:
        """Number of rows that are trained."""
        return len(self.adam.steps)


@dataclass(frozen=True, slots=True)
class Step:
    """One iteration: the numbers that a resident is sent."""

    camera: int
    frame: int
    is_half: bool
    """Whether pictures of half the size are compared."""
    whole: bool
    """As in `StepInput`."""
    means_lr_m: float
    """Learning rate of positions, metres."""
    calm: float
    """Factor of the other learning rates."""
    noise_m: float
    seed: int
    """Of the noise."""
    level: int | None = None
    """Which of the window's cells move together; None: each Gaussian by itself."""


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class Selection:
    """The Gaussians of some steps. A resident may keep what it made of one as long as the selection
    lives."""

    rows: Ints
    """Those that are rendered."""
    trained: Ints
    """Those of them that are updated, all below num_gs."""


class Home:
    """Where the rows of a training live. These live in the host's arrays: nothing has to be fetched
    or sent."""

    def fetch(self, history: bool = False) -> None:
        """Brings the host's parameters and colours up to date; with history Adam's as well."""

    def send(self, rows: npt.NDArray[np.integer[Any]] | slice) -> None:
        """Takes over what the host has changed in `rows`: parameters and Adam's history. The
        latter has been fetched or reset."""

    def send_all(self) -> None:
        """Takes over all of the host's arrays."""


class Resident(Home, ABC):
    """The Gaussians of a training where their steps are computed."""

    @abstractmethod
    def begin_window(self, ages: Floats, cells: Sequence[Ints]) -> None:
        """Prepares the steps of a window. ages: (num_gs,) windows that each row has been trained
        for; cells: (num_gs,) each, what moves together, by `Step.level`."""

    @abstractmethod
    def step(self, step: Step, selection: Selection) -> None:
        """Renders, compares, differentiates and updates. Need not wait for the result."""

    @abstractmethod
    def losses(self, wait: bool) -> list[float]:
        """The losses of the steps since the last call, oldest first; without `wait` only those that
        are known already."""

    @abstractmethod
    def bound_scales(self, selection: Selection, max_scale: float) -> None:
        """Keeps the scales of the trained rows within their bound, see `bound_scales`."""


@dataclass(frozen=True, slots=True)
class MemoryNeeds:
    """The size of a training, for `Backend.plan`."""

    num_gs: int
    sh_degree: int
    pixels: int
    """Of the largest picture."""
    shots: int
    """Pictures that the steps of a window see, and those that the next one brings."""
    has_masks: bool


class Backend(Protocol):
    """A way to compute steps."""

    def plan(self, needs: MemoryNeeds) -> str | None:
        """Plans the memory of a training that `start` will be given; one line about it, None where
        the host's memory is all there is. Raises InvalidError where the device has too little."""

    def step(self, given: StepInput, gradients: Parameters) -> Loss:
        """The loss of a picture. Writes the gradients of the trainable rows into `gradients`; all
        is in host memory."""

    def start(self, training: Training) -> Resident:
        """Takes a training in. The resident uses its arrays until it is dropped."""
