"""The CPU renderer: the oracle of recipe v1 and the fast path where there is no GPU."""

from __future__ import annotations

import numpy as np

from codec.arrays import Floats, Ints
from codec.camera import Camera
from codec.slice import Slice
from codec.splats import Splats
from codec.stream.manifest import Manifest

from .arrivals import Arrivals, Glide
from .blend import blend_tiles
from .colours import SeenColours, project
from .project import Projection, camera_vector
from .recipe import TILE_PX
from .ring import Ring
from .steptimes import StepTimes, step
from .tiles import list_tiles, tile_grid


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
