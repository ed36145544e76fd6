"""Plays a stream in viser, the viewer in a browser that nerfstudio has, until Ctrl-C ends it.

pip install viser
python examples/viserview.py demo/stream 8080
"""

import sys
import time
from typing import Any

import numpy as np
import viser
from scipy.spatial.transform import Rotation

from codec.rig import rig_up
from codec.splats import SH_C0, Splats
from player import Scene


def arrays_of(splats: Splats) -> tuple[np.ndarray, ...]:
    """Centres, covariances, colours and opacities: viser shows one colour from all sides."""
    turns = Rotation.from_quat(splats.quats[:, [1, 2, 3, 0]]).as_matrix()
    axes = turns * np.exp(splats.log_scales)[:, None, :]
    colours = np.clip(0.5 + SH_C0 * splats.sh[:, 0], 0, 1)
    return splats.means, axes @ axes.transpose(0, 2, 1), colours, splats.opacities[:, None]


with Scene.open(sys.argv[1]) as scene:
    server = viser.ViserServer("127.0.0.1", int(sys.argv[2]), label=scene.name, verbose=False)
    camera, start = scene.camera(), server.initial_camera
    server.scene.set_up_direction(rig_up(scene.cameras))
    start.position, start.up = camera.position, -camera.down
    start.look_at = camera.position + camera.forward
    start.fov = 2 * np.arctan(camera.height_px / 2 / camera.fy_px)
    plays = server.gui.add_checkbox("play", True)
    slider: Any = server.gui.add_slider("frame", 0, scene.num_frames - 1, 1, 0)
    shown = server.scene.add_gaussian_splats("/gaussians", *arrays_of(scene.splats(0)))
    print(f"showing {scene.name} at http://127.0.0.1:{server.get_port()}", flush=True)
    frame = 0
    while True:
        if slider.value != frame:
            frame = slider.value
            shown.set_gaussians(*arrays_of(scene.splats(frame)))
        time.sleep(1 / scene.fps)
        if plays.value:
            slider.value = (slider.value + 1) % scene.num_frames
