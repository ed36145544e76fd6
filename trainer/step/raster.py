"""The differentiable CPU rasteriser: player.render's forward kernels and their gradients."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from codec.arrays import Flags, Floats, Ints
from codec.camera import Camera
from codec.splats import array_shapes
from player.render.blend import TileLists, blend_tiles, list_tiles, reach_of, tile_grid
from player.render.project import (
    ALWAYS,
    PROJECTED,
    TILE_PX,
    Projection,
    SeenColours,
    camera_vector,
    project,
)

from .active import active_tiles, trained_ends, with_neighbours
from .backward import (
    G_BLUE,
    G_GREEN,
    G_RED,
    PAIR_GRADIENT,
    blend_tiles_backward,
    colour_backward_kernel,
    project_backward_kernel,
)

NEARLY_ALL = 0.9
"""Share of the tiles from which on leaving the others out gains less than finding them costs."""


@dataclass(frozen=True, slots=True)
class Parameters:
    """R rows of Gaussians that training changes, or their gradients.

    The arrays are those of a `Splats`, which checks its values and stays as it is.
    """

    means: Floats  # (R, 3) float32, metres, world
    log_scales: Floats  # (R, 3) float32
    quats: Floats  # (R, 4) float32, wxyz
    logit_opacities: Floats  # (R,) float32
    sh: Floats  # (R, K, 3) float32

    @staticmethod
    def zeros(rows: int, sh_degree: int) -> Parameters:
        shapes = array_shapes(rows, sh_degree)
        return Parameters(*(np.zeros(shape, np.float32) for shape in shapes))

    @staticmethod
    def zeros_like(other: Parameters, rows: int) -> Parameters:
        """So many rows of the same SH degree."""
        return Parameters(*(np.zeros((rows, *a.shape[1:]), np.float32) for a in other.arrays))

    @property
    def arrays(self) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """In the order of `Splats.arrays`."""
        return self.means, self.log_scales, self.quats, self.logit_opacities, self.sh


@dataclass(frozen=True, slots=True)
class View:
    """A camera prepared for the kernels, once per training camera."""

    camera: Camera
    vector: Floats  # see camera_vector
    near_m: float
    tiles_x: int
    tiles_y: int

    @staticmethod
    def prepare(camera: Camera, near_m: float) -> View:
        tiles_x, tiles_y = tile_grid(camera.width_px, camera.height_px)
        return View(camera, camera_vector(camera, near_m), near_m, tiles_x, tiles_y)


class Scratch:
    """Memory that the steps of a training run use again and again.

    Allocating megabytes in every step costs more in page faults than some kernels take. What a
    call returns lives in here until the next call with the same scratch.
    """

    def __init__(self) -> None:
        self._held: dict[str, Floats] = {}

    def take(self, name: str, *shape: int) -> Floats:
        """A float32 array of this shape with any content, in the memory that `name` had before if
        that is large enough."""
        size = math.prod(shape)
        if name not in self._held or len(self._held[name]) < size:
            self._held[name] = np.empty(size + size // 4, np.float32)
        return self._held[name][:size].reshape(shape)


@dataclass(frozen=True, slots=True)
class Rendered:
    """Values of a forward pass that the backward pass needs."""

    view: View
    rows: Ints  # (M,) int32, of the parameters
    projection: Projection
    lists: TileLists
    picture: Floats  # (3, tiles_y * TILE_PX, tiles_x * TILE_PX) float32, padded to whole tiles
    scratch: Scratch
    active: Flags | None  # (tiles_y, tiles_x): only these and their neighbours are drawn; None: all


def render(
    parameters: Parameters,
    rows: Ints,
    view: View,
    scratch: Scratch | None = None,
    trainable: int | None = None,
) -> Rendered:
    """Renders the Gaussians `rows` (M,) int32 of `parameters` as `view` sees them.

    trainable: draws only the tiles that matter to the gradients of the rows below it, those that
    such a Gaussian reaches and their neighbours, unless that is nearly all; the picture and the
    lists of other tiles have any content. None: draws all.
    """
    scratch = scratch or Scratch()
    count = len(rows)
    projection = Projection(
        scratch.take("projected", count, PROJECTED),
        scratch.take("depths", count),
        scratch.take("boxes", count, 4).view(np.int32),
    )
    # The colours of degree 2 and 3, of all rows; they are new in every step.
    num_kept = len(parameters.means) if parameters.sh.shape[1] > 4 else 0
    seen = SeenColours(
        scratch.take("colours", num_kept, 1, 3), scratch.take("seen from", num_kept, 3), ALWAYS
    )
    project(parameters.arrays, rows, view.vector, view.tiles_x, view.tiles_y, projection, seen)
    reach = reach_of(projection)
    active = wanted = None
    if trainable is not None:
        active = active_tiles(projection, reach, rows < trainable, view.tiles_x, view.tiles_y)
        wanted = with_neighbours(active)
        if wanted.mean() > NEARLY_ALL:
            active = wanted = None
    lists = list_tiles(projection, view.tiles_x, view.tiles_y, reach, wanted)
    picture = scratch.take("picture", 3, view.tiles_y * TILE_PX, view.tiles_x * TILE_PX)
    blend_tiles(
        projection.projected, lists.starts, lists.gaussians, lists.order, view.tiles_x, picture
    )
    return Rendered(view, rows, projection, lists, picture, scratch, active)


def backward(
    rendered: Rendered,
    parameters: Parameters,
    picture_grad: Floats,
    trainable: int,
    gradients: Parameters,
    opacity_reg: float = 0.0,
    scale_reg: float = 0.0,
) -> None:
    """Writes the gradients of the rendered rows below `trainable` into `gradients`.

    picture_grad: d loss / d picture, float32, of the picture's shape, zero in the padding; looked
    at where such a row shows.
    opacity_reg, scale_reg: weights of the mean opacity and the mean scale (metres) over the
    rendered rows in the loss (3DGS-MCMC, section 3.4).
    """
    lists, view = rendered.lists, rendered.view
    pair_grads = rendered.scratch.take("pair gradients", len(lists.pairs), PAIR_GRADIENT)
    moves = rendered.rows < trainable
    ends, order = trained_ends(lists, moves)
    blend_tiles_backward(
        rendered.projection.projected, lists.starts, ends, lists.gaussians, lists.pairs, moves,
        order, view.tiles_x, rendered.picture, picture_grad, pair_grads,
    )  # fmt: skip
    count = max(len(rendered.rows), 1)
    trained = np.flatnonzero(moves).astype(np.int32)
    project_backward_kernel(
        *parameters.arrays, rendered.rows, trained, view.vector,
        rendered.projection.projected, lists.pair_starts, pair_grads,
        np.float32(opacity_reg / count), np.float32(scale_reg / (3 * count)),
        *gradients.arrays,
    )  # fmt: skip
    if parameters.sh.shape[1] > 4:
        colour_backward_kernel(
            parameters.means, parameters.sh, rendered.rows, trained, view.vector,
            rendered.projection.projected, lists.pair_starts, pair_grads,
            gradients.means, gradients.sh,
        )  # fmt: skip


def weighed(rendered: Rendered, planes: Floats) -> tuple[Floats, Floats, Floats]:
    """(M,) each: for three planes, of the picture's shape, the sum over the pixels of a Gaussian's
    blending weight times the plane's value."""
    lists = rendered.lists
    pair_grads = rendered.scratch.take("pair gradients", len(lists.pairs), PAIR_GRADIENT)
    # The gradient of a sum of weight * colour * plane by the colour is the sum of weight * plane.
    everyone = np.ones(len(rendered.rows), np.bool_)
    blend_tiles_backward(
        rendered.projection.projected, lists.starts, lists.starts[1:], lists.gaussians, lists.pairs,
        everyone, lists.order, rendered.view.tiles_x, rendered.picture, planes, pair_grads,
    )  # fmt: skip
    sums = []
    for column in (G_RED, G_GREEN, G_BLUE):
        # Pairs are numbered Gaussian by Gaussian: differences of a running sum.
        running = np.concatenate([[0.0], np.cumsum(pair_grads[:, column], dtype=np.float64)])
        sums.append(np.diff(running[lists.pair_starts]).astype(np.float32))
    return sums[0], sums[1], sums[2]
