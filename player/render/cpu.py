"""The CPU renderer: the oracle of recipe v1 and the fast path where there is no GPU. It keeps the
Gaussians of the current window in fixed arrays, swin_size lanes of slices, and draws depth with
distances as colours.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from codec.arrays import Floats, Ints
from codec.camera import Camera
from codec.errors import InvalidError
from codec.slice import HIDDEN, Slice, blank_splats, kept_offsets, window_births
from codec.splats import SH_C0, Splats
from codec.stream.manifest import Manifest

from .blend import blend_tiles, list_tiles, tile_grid
from .project import TILE_PX, Projection, SeenColours, camera_vector, project
from .upload import Arrivals, Glide, check_slice

Rows = npt.NDArray[np.int32] | slice


class Ring:
    """`swin_size` lanes of `slice_size` Gaussians; a slice replaces what its lane held,
    or some rows of it.

    Invariant: lane `birth % swin_size` holds what it shows from the birth put there last on, so
    memory stays the same however many slices come. Behind the lanes lie spare rows for Gaussians
    that fade out, as many as there ever were at once.
    """

    def __init__(self, swin_size: int, slice_size: int, sh_degree: int) -> None:
        if swin_size < 1 or slice_size < 1:
            raise InvalidError(
                f"a ring needs at least one lane of one Gaussian, "
                f"not {swin_size} lanes of {slice_size}"
            )
        self.swin_size = swin_size
        self.slice_size = slice_size
        self.sh_degree = sh_degree
        self.splats = blank_splats(swin_size * slice_size, sh_degree)
        """All lanes, one after another, whether they show or not."""
        self.seen = SeenColours.none_of(len(self.splats), sh_degree)
        """The colours in which they were seen last."""
        self._start_offsets = np.zeros((swin_size, slice_size), np.uint8)
        self._births: list[int | None] = [None] * swin_size
        self._num_leaving = 0

    def put(self, slice: Slice) -> None:
        """Copies `slice` into its lane, in place of what was there in the rows that it changes."""
        check_slice(slice, self.slice_size, self.sh_degree)
        lane, rows = slice.lane(self.swin_size), slice.rows
        slice.check_follows(self._births[lane], self.swin_size)
        offsets = self._start_offsets[lane]
        if rows is None:
            offsets[:] = HIDDEN
            self._write(lane, np.s_[: len(slice.splats)], slice)
        else:
            offsets[:] = kept_offsets(offsets)
            self._write(lane, rows, slice)
        self._births[lane] = slice.birth

    def correct(self, slice: Slice) -> None:
        """Copies the rows of `slice` into its lane, if that still has the slice that it corrects;
        all other rows stay."""
        lane = slice.lane(self.swin_size)
        if slice.rows is not None and slice.corrects(self._births[lane]):
            self._write(lane, slice.rows, slice)

    def put_leaving(self, leaving: Splats) -> None:
        """Shows `leaving` in every frame, in place of those put here before."""
        first, count = self.swin_size * self.slice_size, len(leaving)
        if first + count > len(self.splats):
            lanes = self.splats.take(slice(first))
            self.splats = Splats.concatenate([lanes, blank_splats(count, self.sh_degree)])
            self.seen = SeenColours.none_of(len(self.splats), self.sh_degree)
        for array, changed in zip(self.splats.arrays, leaving.arrays, strict=True):
            array[first : first + count] = changed
        self.seen.forget(first, first + count, slice(None))
        self._num_leaving = count

    def _write(self, lane: int, rows: Rows, slice: Slice) -> None:
        first = lane * self.slice_size
        for array, changed in zip(self.splats.arrays, slice.splats.arrays, strict=True):
            array[first : first + self.slice_size][rows] = changed
        self._start_offsets[lane][rows] = slice.start_offsets
        self.seen.forget(first, first + self.slice_size, rows)

    def active_rows(self, frame: int) -> Ints:
        """(M,) int32: the rows of `splats` that show at `frame`, oldest slice first."""
        spare = self.swin_size * self.slice_size
        parts = [np.arange(spare, spare + self._num_leaving, dtype=np.int32)]
        for birth in window_births(frame, self.swin_size):
            lane = birth % self.swin_size
            if self._births[lane] != birth:
                continue
            shown = np.flatnonzero(self._start_offsets[lane] <= frame - birth)
            parts.append((shown + lane * self.slice_size).astype(np.int32))
        return np.concatenate(parts)

    def active(self, frame: int) -> Splats:
        """The Gaussians that show at `frame`, oldest slice first."""
        return self.splats.take(self.active_rows(frame))


@dataclass(slots=True)
class StepTimes:
    """Time of each step when it ran last, until it was finished, milliseconds."""

    upload_ms: float = 0.0
    """New slices to where they are drawn from; 0 where there was none."""
    sort_ms: float = 0.0
    """Which Gaussians show, and their order; on the CPU also where on the picture."""
    draw_ms: float = 0.0
    """Blending."""


@contextmanager
def step(times: StepTimes | None, name: str, finish: Callable[[], object]) -> Iterator[None]:
    """Notes what the block took as `name`; without `times` nothing is waited for.

    finish: waits for what the block only asked for.
    """
    if times is None:
        yield
        return
    began_s = time.perf_counter()
    yield
    finish()
    setattr(times, name, (time.perf_counter() - began_s) * 1000)


class CpuRenderer:
    """Draws a stream on the CPU; see renderer.Renderer."""

    def __init__(self, manifest: Manifest) -> None:
        self._ring = Ring(manifest.swin_size, manifest.slice_size, manifest.sh_degree)
        self._manifest = manifest
        self._arrivals: Arrivals[Slice] = Arrivals()
        self._glide = Glide()
        self.name = "CPU"
        self.uploaded_bytes = 0
        self.times: StepTimes | None = None
        self.alpha = False

    @property
    def seen(self) -> SeenColours:
        """The colours that are kept; a property for tests and benches."""
        return self._ring.seen

    def put(self, slice: Slice) -> None:
        self._arrivals.append(slice.birth, slice)

    def forget_waiting(self) -> None:
        self._arrivals.drop()

    def upload(self, frame: int) -> None:
        with step(self.times, "upload_ms", _nothing):
            self.glide(1.0)
            taken = self._arrivals.pop_until(frame)
            for slice in taken:
                self._ring.put(slice)
                self.uploaded_bytes += slice.num_bytes
            self._glide.start(frame, [(slice.birth, slice.motion) for slice in taken])

    def glide(self, share: float) -> bool:
        moved, leaving = self._glide.to(share)
        for slice in moved:
            self._ring.correct(slice)
            self.uploaded_bytes += slice.num_bytes
        if moved:
            self._ring.put_leaving(Splats.concatenate(leaving))
        return bool(moved)

    def render(self, frame: int, camera: Camera) -> Floats:
        self.upload(frame)
        return self.render_again(frame, camera)

    def render_again(self, frame: int, camera: Camera) -> Floats:
        # Drawn from where they are: a copy of all that shows would take a sixth of the time.
        rows = self._ring.active_rows(frame)
        near_m = self._manifest.near_of(camera)
        return _draw(
            self._ring.splats, rows, camera, near_m, self._ring.seen, self.times, self.alpha
        )

    def close(self) -> None:
        pass


def _nothing() -> None:
    """The CPU has done a thing when it comes back from it."""


def render_splats(splats: Splats, camera: Camera, near_m: float, alpha: bool = False) -> Floats:
    """(H, W, 3) float32 picture of `splats`, black background, not clamped above 1.

    alpha: (H, W, 4) with premultiplied colours, as `Renderer.alpha` has them. near_m: Gaussians
    whose centre lies nearer along the viewing axis are not drawn, metres.
    """
    seen = SeenColours.none_of(len(splats), splats.sh_degree)
    rows = np.arange(len(splats), dtype=np.int32)
    return _draw(splats, rows, camera, near_m, seen, None, alpha)


def _draw(
    splats: Splats,
    rows: Ints,
    camera: Camera,
    near_m: float,
    seen: SeenColours,
    times: StepTimes | None,
    alpha: bool = False,
) -> Floats:
    """The picture of some rows of `splats`; of equally far ones the first is in front. alpha: with
    a fourth channel."""
    tiles_x, tiles_y = tile_grid(camera.width_px, camera.height_px)
    with step(times, "sort_ms", _nothing):
        projection = Projection.allocate(len(rows))
        vector = camera_vector(camera, near_m)
        project(splats.arrays, rows, vector, tiles_x, tiles_y, projection, seen)
        lists = list_tiles(projection, tiles_x, tiles_y)
    with step(times, "draw_ms", _nothing):
        picture = np.empty((3 + alpha, tiles_y * TILE_PX, tiles_x * TILE_PX), np.float32)
        blend_tiles(
            projection.projected, lists.starts, lists.gaussians, lists.order, tiles_x, picture
        )
        cropped = picture[:, : camera.height_px, : camera.width_px]
        return np.ascontiguousarray(cropped.transpose(1, 2, 0))


LEAST_COVERAGE = 0.5
"""Share of a pixel that Gaussians must cover for it to have a depth."""


def render_depth(splats: Splats, camera: Camera, near_m: float) -> Floats:
    """(H, W) float32 depth along the viewing axis, metres: the mean over the Gaussians of a pixel,
    weighted as their colours are; NaN where they cover less than half of it.

    near_m: Gaussians whose centre lies nearer are not drawn, metres.
    """
    axis, distance_m = camera.w2c[2, :3], camera.w2c[2, 3]
    depths_m = np.maximum(splats.means @ axis + distance_m, 0.0)
    values = np.stack([depths_m, np.ones_like(depths_m), np.zeros_like(depths_m)], axis=1)
    sh = ((values - 0.5) / SH_C0).astype(np.float32)[:, None, :]
    picture = render_splats(replace(splats, sh=sh), camera, near_m)
    weighted_m, covered = picture[:, :, 0], picture[:, :, 1]
    depth_m = weighted_m / np.maximum(covered, np.float32(LEAST_COVERAGE))
    depth_m[covered < LEAST_COVERAGE] = np.nan
    return depth_m.astype(np.float32, copy=False)
