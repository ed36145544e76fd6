"""What to play and how to show it, parsed once from the command line."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from codec.console import option
from codec.errors import InvalidError
from codec.framerange import FRAMES, FrameRange
from codec.stream.manifest import Manifest
from player.link.linktext import read_link
from player.render.renderer import GlVersion, RendererKind
from player.show.sink import check_output
from player.view.path import CameraPath, Size, camera_path, check_path
from server.abr.link.link import Link


@dataclass(frozen=True, slots=True)
class CameraPathName:
    """A camera path as the user writes it; view/path.py says how.

    Raises InvalidError for a text that is not a path in any stream.
    """

    text: str

    def __post_init__(self) -> None:
        check_path(self.text)

    def __str__(self) -> str:
        return self.text

    def of(self, manifest: Manifest, size: Size | None, frames: FrameRange) -> CameraPath:
        """The path in the stream of `manifest`; see `camera_path`."""
        return camera_path(self.text, manifest, size, frames)


def parse_layers(text: str) -> int | None:
    """A number of layers; None for `auto`. Raises InvalidError."""
    if text == "auto":
        return None
    if not (text.isdecimal() and int(text) >= 1):
        raise InvalidError(f"layers {text!r} are neither auto nor a number from 1 on")
    return int(text)


LAYERS = option("auto|N", parse_layers, lambda layers: "auto" if layers is None else str(layers))
CAMERA = option("PATH", CameraPathName)
SIZE = option("WxH", Size.parse)
LINK = option("RATE|TRACE", read_link)


@dataclass(frozen=True, slots=True)
class PlayConfig:
    """What to play, and how to show it."""

    source: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="SOURCE")]]
    """Folder of a stream, URL of a served stream (http://HOST:PORT, .../watch/NAME), or any URL
    under which a stream's files lie."""
    capture: Annotated[Path | None, tyro.conf.arg(metavar="OUT")] = None
    """Write every frame, exactly once, to this .mp4 or folder of PNGs. Without it: a window."""
    layers: Annotated[int | None, LAYERS] = None
    """Layers of each slice, 1 to all; auto lets a server choose, and takes all elsewhere."""
    camera: Annotated[CameraPathName, CAMERA] = CameraPathName("default")
    """default, camera:NAME, orbit, orbit:DEGREES, or a .json file of key frames."""
    size: Annotated[Size | None, SIZE] = None
    """Size of the picture, as 1280x720; without it that of the camera."""
    frames: Annotated[FrameRange, FRAMES] = field(default_factory=FrameRange)
    """Frames to show, as 30:60 (without 60), 30: or :60."""
    renderer: RendererKind = RendererKind.AUTO
    """auto takes OpenGL where it works, and says so where it does not."""
    gl: GlVersion = GlVersion.AUTO
    """The OpenGL to draw with; auto takes 4.3, which orders the Gaussians itself, on a GPU."""
    link: Annotated[Link | None, LINK] = None
    """Play over a slower link: a rate (8M), a rate and a latency (8M,20ms), or a trace's file."""
    report: Annotated[Path | None, tyro.conf.arg(metavar="JSON")] = None
    """Write when each packet came and each frame showed, the rates, and the totals to this JSON
    file; also when Ctrl-C ends the play."""
    plot: Annotated[Path | None, tyro.conf.arg(metavar="PNG")] = None
    """Draw link, goodput, layers and buffer over time into this picture."""
    profile: Annotated[Path | None, tyro.conf.arg(metavar="PNG")] = None
    """Draw every frame of a folder as fast as it goes, without showing it; print what each stage
    takes, and draw it into this picture."""
    loop: Annotated[int, tyro.conf.arg(metavar="N")] = 1
    """Play the frames so often; each time the stream is asked for anew."""

    def __post_init__(self) -> None:
        """Raises InvalidError for options that do not go together, whatever the stream is."""
        if self.link is not None and not self.source.lower().startswith("http://"):
            raise InvalidError(f"--link slows down http:// URLs; {self.source} is not one")
        if self.capture is not None:
            check_output(self.capture)
        elif self.renderer is RendererKind.CPU and self.profile is None:
            raise InvalidError("a window is drawn by OpenGL; --renderer cpu goes with --capture")
        if self.renderer is RendererKind.CPU and self.gl is not GlVersion.AUTO:
            raise InvalidError(f"--gl {self.gl} does not go with --renderer cpu")
        if self.loop < 1:
            raise InvalidError(f"loop {self.loop}: play the frames once at least")
        if self.profile is not None:
            self._check_profile()
        written = (("report", self.report), ("plot", self.plot), ("profile", self.profile))
        for name, path in written:
            if path is not None and not path.parent.is_dir():
                raise InvalidError(f"{name} {path}: there is no folder {path.parent}")

    def _check_profile(self) -> None:
        if "://" in self.source:
            raise InvalidError(f"--profile measures a stream in a folder; {self.source} is not one")
        others = (self.capture, self.report, self.plot, self.link)
        if self.loop != 1 or any(other is not None for other in others):
            raise InvalidError(
                "--profile draws once and shows nothing; --capture, --report, --plot, --link and "
                "--loop do not go with it"
            )
