"""swings-stream as it is installed: codec's command, and what draws its posters."""

from __future__ import annotations

from codec.__main__ import main as stream_command
from codec.arrays import Floats
from codec.camera import Camera
from codec.splats import Splats


def main() -> None:
    stream_command(draw_poster)


def draw_poster(splats: Splats, camera: Camera, near_m: float) -> Floats:
    """See `codec.stream.pictures.Draw`."""
    # Here, because it loads slowly and few of the subcommands draw.
    from player.render.cpu import render_splats

    return render_splats(splats, camera, near_m)
