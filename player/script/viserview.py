"""A stream in viser, the viewer in a browser that nerfstudio has (extra `viser`).

viser draws by itself: it gets the Gaussians of each frame, and shows one colour of each from all
sides.
"""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from codec.camera import Camera
from codec.console import say
from codec.errors import InvalidError
from codec.framerange import FrameRange
from codec.pose import quat_of
from codec.rig import rig_up
from codec.splats import SH_C0, Splats
from codec.stream.views import scene_centre
from player.config import PlayConfig

from .openscene import Scene

Floats = npt.NDArray[np.float32]

HOST = "127.0.0.1"
"""Where the server listens: every client that reaches it can move the slider."""

LOOK_S = 0.005
"""Seconds between two looks at the controls."""

FRUSTUM_SIZE = 0.05
"""Size of a camera's frustum, as a share of its distance to the scene's centre."""


def viser_arrays(splats: Splats) -> tuple[Floats, Floats, Floats, Floats]:
    """Centres (N, 3), covariances (N, 3, 3), colours (N, 3) and opacities (N, 1) in 0..1: what
    viser takes."""
    quats = splats.quats / np.linalg.norm(splats.quats, axis=1, keepdims=True)
    w, x, y, z = quats.T
    rotations = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    ).transpose(2, 0, 1)
    axes = rotations * np.exp(splats.log_scales)[:, None, :]
    covariances = axes @ axes.transpose(0, 2, 1)
    colours = np.clip(SH_C0 * splats.sh[:, 0] + 0.5, 0, 1)
    opacities = 0.5 + 0.5 * np.tanh(0.5 * splats.logit_opacities[:, None])
    return splats.means, covariances, colours, opacities


def show_in_viser(config: PlayConfig) -> None:
    """Shows the stream until it is interrupted."""
    assert config.viser is not None
    with Scene.open(
        config.source,
        layers=config.layers,
        delivery=config.delivery,
        max_gaussians=config.max_gaussians,
    ) as scene:
        frames = config.frames.of(scene.num_frames, scene.name)
        shown = FrameRange(frames[0], frames[-1] + 1)
        camera = config.camera.of(scene.manifest, None, shown)(frames[0])
        with ViserView(scene, config.viser, frames, camera) as view:
            say(f"showing {scene.name} at {view.url}")
            sys.stdout.flush()
            view.play()


class ViserView:
    """A viser server that shows `scene`, with a slider for the frame; use it in a `with` block, or
    close it."""

    def __init__(
        self,
        scene: Scene,
        port: int = 8080,
        frames: range | None = None,
        camera: Camera | None = None,
    ) -> None:
        """port: viser takes the next one that is free; 0 takes any. frames: those of the slider;
        None takes all. camera: where the view begins; None takes the default one.

        Raises InvalidError where viser is not installed.
        """
        try:
            import viser
        except ImportError as error:
            raise InvalidError(
                "viser is not installed; install it with pip install '.[viser]' in the "
                "swings folder"
            ) from error
        self._scene = scene
        self._frames = scene.frames() if frames is None else frames
        self._shown: int | None = None
        self._gaussians: Any = None
        self._playing: Any = None
        self._slider: Any = None
        self._server: Any = viser.ViserServer(HOST, port, label=scene.name, verbose=False)
        try:
            self._add_cameras(scene.camera(camera))
            self._add_controls()
            self.show(self._frames[0])
        except BaseException:
            self._server.stop()
            raise

    @property
    def server(self) -> Any:
        """The viser.ViserServer, to which more can be added."""
        return self._server

    @property
    def url(self) -> str:
        """URL of the page to open in a browser."""
        return f"http://{HOST}:{self._server.get_port()}"

    @property
    def playing(self) -> bool:
        """Whether `play` is ticked."""
        return bool(self._playing.value)

    @playing.setter
    def playing(self, value: bool) -> None:
        self._playing.value = value

    @property
    def frame(self) -> int:
        """Where the slider is."""
        return min(int(self._slider.value), self._frames[-1])

    @frame.setter
    def frame(self, value: int) -> None:
        self._slider.value = value

    def _add_cameras(self, first: Camera) -> None:
        manifest, server = self._scene.manifest, self._server
        centre, up = scene_centre(manifest), rig_up(manifest.cameras)
        server.scene.set_up_direction(up)
        start = server.initial_camera
        start.position, start.up = first.position, -first.down
        depth_m = max(float((centre - first.position) @ first.forward), 0.1)
        start.look_at = first.position + depth_m * first.forward
        start.fov = _fov_rad(first)
        for number, camera in enumerate(manifest.cameras):
            server.scene.add_camera_frustum(
                f"/cameras/{number} {camera.name.replace('/', '_')}",
                fov=_fov_rad(camera),
                aspect=camera.width_px / camera.height_px,
                scale=FRUSTUM_SIZE * float(np.linalg.norm(camera.position - centre)),
                wxyz=quat_of(camera.w2c[:3, :3].T),
                position=camera.position,
                thickness=1.5,
                thickness_units="screen",
                # From where one looks out of it, it only frames the picture.
                visible=not np.allclose(camera.w2c, first.w2c),
            )

    def _add_controls(self) -> None:
        first, last = self._frames[0], self._frames[-1]
        gui = self._server.gui
        self._playing = gui.add_checkbox("play", True)
        # viser refuses a slider that cannot move.
        self._slider = gui.add_slider("frame", first, max(last, first + 1), 1, first)

    def show(self, frame: int) -> None:
        """Sends the Gaussians of `frame` to all clients, present and future. Raises what
        `Scene.splats` raises."""
        arrays = viser_arrays(self._scene.splats(frame))
        if self._gaussians is None:
            self._gaussians = self._server.scene.add_gaussian_splats("/gaussians", *arrays)
        else:
            self._gaussians.set_gaussians(*arrays)
        self._shown = frame
        self.frame = frame

    def play(self, for_s: float = float("inf")) -> None:
        """Shows frame after frame, again and again, while `play` is ticked, and else the one that
        the slider says. A frame that is not ready in time is left out.

        Returns after `for_s` seconds; without that, when it is interrupted.
        """
        fps, frames = self._scene.fps, self._frames
        until_s = time.monotonic() + for_s
        since_s, since = time.monotonic(), frames[0] if self._shown is None else self._shown
        while (now_s := time.monotonic()) < until_s:
            if self.frame != self._shown or not self.playing:
                since_s, since = now_s, self.frame  # somebody has moved the slider
            gone = int((now_s - since_s) * fps)
            frame = frames[(since - frames[0] + gone) % len(frames)]
            if frame != self._shown:
                self.show(frame)
            time.sleep(LOOK_S)

    def close(self) -> None:
        """Ends the server; closing twice is the same as once. The scene stays open."""
        server, self._server = self._server, None
        if server is not None:
            server.stop()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _fov_rad(camera: Camera) -> float:
    """Vertical."""
    return 2 * float(np.arctan(camera.height_px / 2 / camera.fy_px))
