"""The options of a playback, parsed once from the command line."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from codec.console import option
from codec.errors import InvalidError
from codec.framerange import FRAMES, FrameRange
from codec.helptext import Groups
from codec.storage.objectstore import without_credentials
from codec.stream.captions import LANGUAGE
from codec.stream.manifest import Manifest
from codec.stream.reader import DEFAULT_MAX_GAUSSIANS
from player.link.relay import read_link
from player.network.fetch import RetryConfig
from player.playout.clock import MAX_RATE, MIN_RATE, check_fps
from player.render.renderer import GlVersion, RendererKind
from player.show.background import BLACK, TRANSPARENT, Colour
from player.show.sink import VIDEO_SUFFIX, check_output, check_still
from player.source.opener import SourceConfig, split_source
from player.view.path import MOMENT, CameraPath, Moment, Size, camera_path, check_path
from server.abr.link import Link


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

    @property
    def moves(self) -> bool:
        """Whether the camera may change from frame to frame."""
        return not (self.text == "default" or self.text.startswith("camera:"))

    def of(self, manifest: Manifest, size: Size | None, frames: FrameRange) -> CameraPath:
        """The path in the stream of `manifest`; see `camera_path`."""
        return camera_path(self.text, manifest, size, frames)


def parse_layers(text: str) -> int | None:
    """A number of layers; None for `auto`. Raises InvalidError."""
    if text == "auto":
        return None
    if not (text.isdecimal() and int(text) >= 1):
        raise InvalidError(f"layers {text!r} is neither auto nor a whole number of 1 or more")
    return int(text)


def parse_loop(text: str) -> int | None:
    """How often to play; None for `forever`. Raises InvalidError."""
    if text == "forever":
        return None
    if not (text.isdecimal() and len(text) <= 9 and int(text) >= 1):
        raise InvalidError(f"loop {text!r} is neither forever nor a whole number of 1 or more")
    return int(text)


def parse_colour(text: str) -> Colour:
    """A colour as `#RRGGBB`. Raises InvalidError."""
    if not re.fullmatch("#?[0-9a-fA-F]{6}", text):
        raise InvalidError(f"colour {text!r} is not RRGGBB, such as 336699")
    red, green, blue = (n / 255 for n in bytes.fromhex(text.removeprefix("#")))
    return red, green, blue


def parse_background(text: str) -> Colour | None:
    """A colour as `#RRGGBB`, or TRANSPARENT for `transparent`. Raises InvalidError."""
    return TRANSPARENT if text == "transparent" else parse_colour(text)


def _background_text(background: Colour | None) -> str:
    return "transparent" if background is None else _colour_text(background)


def _colour_text(colour: Colour) -> str:
    return bytes(round(255 * part) for part in colour).hex()


BACKGROUND = option("RRGGBB|transparent", parse_background, _background_text)
LOOP = option("N|forever", parse_loop, lambda loop: "forever" if loop is None else str(loop))


def parse_patience(text: str) -> RetryConfig:
    """Seconds to go on trying. Raises InvalidError."""
    try:
        return RetryConfig(float(text))
    except ValueError as error:
        raise InvalidError(f"patience {text!r} is not a number of seconds, 0 to 86400") from error


LAYERS = option("auto|N", parse_layers, lambda layers: "auto" if layers is None else str(layers))
CAMERA = option("PATH", CameraPathName)
PATIENCE = option("S", parse_patience, lambda retry: f"{retry.patience_s:g}")
SIZE = option("WxH", Size.parse)
LINK = option("RATE|TRACE", read_link)


NO_CAPTIONS = "off"

MAX_TURN_S = 3600.0
"""Longest turn of the camera around a still, seconds."""


class PictureKind(StrEnum):
    """The contents of a picture."""

    COLOUR = "colour"
    DEPTH = "depth"
    MASK = "mask"


@dataclass(frozen=True, slots=True)
class PlayConfig:
    """The stream to play, and how to show it."""

    EVERYDAY: ClassVar[Groups] = {
        "Picture": ("camera", "size", "background", "layers", "interpolate", "renderer"),
        "Time": ("frames", "loop", "rate"),
        "Files": ("capture", "fps", "still", "turntable", "picture"),
        "Sound and captions": ("mute", "volume", "captions"),
        "Network": ("link", "report", "plot"),
    }

    source: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="SOURCE")]]
    """Folder of a stream or its .swings file, URL of a served stream (http://HOST:PORT,
    .../watch/NAME), or any URL at which a stream's files, or its .swings file, are hosted. Several
    such URLs of one stream may be given, separated by commas: if a host stops answering, the player
    switches to the next URL."""
    capture: Annotated[Path | None, tyro.conf.arg(metavar="OUT")] = None
    """Write the frames to this .mp4 (H.264) or folder of PNGs: each exactly once, or a picture for
    each moment of --fps. Without this option, the stream plays in a window."""
    fps: float | None = None
    """Pictures per second of the --capture, up to 1000. Without this option, the rate of the
    stream."""
    interpolate: bool = True
    """Show motion between two frames where the screen or the --capture is faster than the stream.
    With --no-interpolate each frame stands until the next one."""
    layers: Annotated[int | None, LAYERS] = None
    """Number of layers of each slice, 1 to all. auto adapts it to the rate of the link in a window
    and with --link, and uses all layers otherwise."""
    camera: Annotated[CameraPathName, CAMERA] = CameraPathName("default")
    """Camera path: default, camera:NAME, orbit, orbit:DEGREES, or a .json file of key frames or
    of a camera path of nerfstudio."""
    size: Annotated[Size | None, SIZE] = None
    """Size of the picture, such as 1280x720. Without this option, it is the camera's size."""
    frames: Annotated[FrameRange, FRAMES] = field(default_factory=FrameRange)
    """Frames to show, such as 30:60 (frame 60 excluded), 30: or :60."""
    renderer: RendererKind = RendererKind.AUTO
    """auto uses OpenGL where it works; elsewhere it logs the reason and draws on the CPU."""
    gl: GlVersion = GlVersion.AUTO
    """OpenGL version. auto uses 4.3 on a GPU that has it, and 3.3 elsewhere. With 4.3 the GPU
    sorts the Gaussians."""
    link: Annotated[Link | None, LINK] = None
    """Play over an emulated slower link: a rate (8M), a rate and a latency (8M,20ms), or a trace
    file."""
    report: Annotated[Path | None, tyro.conf.arg(metavar="JSON")] = None
    """Write the arrival time of each packet, the display time of each frame, the rates and the
    totals to this JSON file. The file is also written when Ctrl-C ends the play."""
    plot: Annotated[Path | None, tyro.conf.arg(metavar="PNG")] = None
    """Plot the link's rate, the goodput, the layers and the buffer over time to this PNG file."""
    profile: Annotated[Path | None, tyro.conf.arg(metavar="PNG")] = None
    """Draw every frame of a stream in a folder as fast as possible, without showing it. Print the
    time of each stage, and plot it to this PNG file."""
    patience: Annotated[RetryConfig, PATIENCE] = field(default_factory=RetryConfig)
    """Seconds for which the player retries a failing server; with 0 it gives up at once."""
    other_hosts: bool = False
    """Allow a stream's links and redirects to lead to hosts other than the host in SOURCE."""
    max_gaussians: int = DEFAULT_MAX_GAUSSIANS
    """Refuse a stream with more Gaussians per frame: a file of a few kilobytes can require
    gigabytes of memory."""
    loop: Annotated[int | None, LOOP] = 1
    """Play the frames N times, or forever. Each repetition requests the stream again."""
    rate: float = 1.0
    """Playback rate in a window: seconds of the stream per second, 0.1 to 4."""
    background: Annotated[Colour | None, BACKGROUND] = BLACK
    """Colour behind the Gaussians; transparent gives PNGs an alpha channel."""
    still: Annotated[Moment | None, MOMENT] = None
    """Draw only this frame, or the frame at this time (2.5s), to the .png file of --capture. All
    layers are drawn unless --layers is given."""
    picture: PictureKind = PictureKind.COLOUR
    """Kind of the pictures of --capture, --still and --turntable: colour; depth along the viewing
    axis, 0 where nothing is; or mask, the share of a pixel that Gaussians cover. PNGs hold depth
    in thousandths of the stream's unit (16 bits) and masks in 8 bits."""
    turntable: Annotated[float | None, tyro.conf.arg(metavar="SECONDS")] = None
    """Move the camera around the still once in this time, or along --camera if that path moves.
    --capture names the .mp4 file or folder of PNGs."""
    mute: bool = False
    """Play without the stream's sound, and capture without a sound track."""
    volume: float = 1.0
    """Loudness of the sound, 0 to 1."""
    captions: Annotated[str, tyro.conf.arg(metavar="LANG|off")] = NO_CAPTIONS
    """Show the captions in this language, such as en, in the window. The key C changes it."""

    @property
    def name(self) -> str:
        """The source for people: without the name and password that its URL may hold."""
        return without_credentials(self.source)

    @property
    def delivery(self) -> SourceConfig:
        return SourceConfig(self.patience, self.other_hosts)

    def __post_init__(self) -> None:
        """Raises InvalidError for options that do not go together, whatever the stream is."""
        if self.link is not None and not self.source.lower().startswith("http://"):
            raise InvalidError(f"--link works only with http:// URLs, not with {self.name}")
        if self.still is not None or self.turntable is not None:
            self._check_still()
        elif self.capture is not None:
            check_output(self.capture)
            if self.picture is not PictureKind.COLOUR:
                self._refuse(f"--picture {self.picture}", *self._of_plays)
        elif self.renderer is RendererKind.CPU and self.profile is None:
            raise InvalidError("--renderer cpu cannot draw in a window; add --capture")
        elif not MIN_RATE <= self.rate <= MAX_RATE:
            raise InvalidError(f"rate {self.rate} is not within {MIN_RATE:g}..{MAX_RATE:g}")
        if self.renderer is RendererKind.CPU and self.gl is not GlVersion.AUTO:
            raise InvalidError(f"--gl {self.gl} cannot be combined with --renderer cpu")
        if self.link is not None and len(split_source(self.source)) > 1:
            raise InvalidError("--link works with only one host; give one URL")
        if not 0 <= self.volume <= 1:
            raise InvalidError(f"volume {self.volume} is not within 0..1")
        if not re.fullmatch(LANGUAGE, self.captions):
            raise InvalidError(
                f"captions {self.captions!r} is neither off nor a language such as en or pt-BR"
            )
        if self.capture is not None:
            self._refuse("--capture", ("--loop forever", self.loop is None), *self._of_windows)
        if self.fps is not None:
            if self.capture is None or self.still is not None:
                raise InvalidError("--fps is the rate of a film; add --capture, without --still")
            check_fps(self.fps)
            not_colour = self.picture is not PictureKind.COLOUR
            self._refuse("--fps", (f"--picture {self.picture}", not_colour))
        if self.profile is not None:
            self._check_profile()
        self._check_background()
        self._check_picture()
        written = (
            ("report", self.report),
            ("plot", self.plot),
            ("profile", self.profile),
        )
        for name, path in written:
            if path is not None and not path.parent.is_dir():
                raise InvalidError(f"{name} {path}: there is no folder {path.parent}")

    @property
    def _of_plays(self) -> tuple[tuple[str, bool], ...]:
        """Which options are given that only a play on a time line has."""
        return (
            ("--loop", self.loop != 1),
            ("--link", self.link is not None),
            ("--report", self.report is not None),
            ("--plot", self.plot is not None),
            *self._of_windows,
        )

    @property
    def _of_windows(self) -> tuple[tuple[str, bool], ...]:
        """Which options are given that only a window has."""
        return (
            ("--rate", self.rate != 1),
            ("--captions", self.captions != NO_CAPTIONS),
        )

    def _refuse(self, option: str, *others: tuple[str, bool]) -> None:
        for name, given in others:
            if given:
                raise InvalidError(f"{name} cannot be combined with {option}")

    def _check_still(self) -> None:
        if self.still is None:
            raise InvalidError("--turntable needs a still; choose its frame with --still")
        if self.capture is None:
            raise InvalidError("--still needs an output file; name it with --capture OUT.png")
        self._refuse("--still", ("--frames", self.frames != FrameRange()), *self._of_plays)
        if self.turntable is None:
            check_still(self.capture)
            return
        if not (math.isfinite(self.turntable) and 0 < self.turntable <= MAX_TURN_S):
            raise InvalidError(
                f"turntable {self.turntable:g}: the time must be more than 0 and at most "
                f"{MAX_TURN_S:g} seconds"
            )
        check_output(self.capture)

    def _check_background(self) -> None:
        if self.background is not TRANSPARENT:
            return
        if self.capture is None:
            raise InvalidError("--background transparent needs --capture with PNGs")
        if self.capture.suffix.lower() == VIDEO_SUFFIX:
            raise InvalidError(
                f"{self.capture}: an .mp4 has no alpha channel for --background transparent; "
                "write a folder of PNGs instead"
            )

    def _check_picture(self) -> None:
        if self.picture is PictureKind.COLOUR:
            return
        self._refuse(f"--picture {self.picture}", ("--background", self.background != BLACK))
        if self.capture is None:
            raise InvalidError(f"--picture {self.picture} needs an output; name it with --capture")
        if self.capture.suffix.lower() == VIDEO_SUFFIX:
            raise InvalidError(
                f"{self.capture}: --picture {self.picture} is written as PNGs; name a folder"
            )

    @property
    def draws_frames(self) -> bool:
        """Whether this draws frames one by one instead of playing the stream."""
        return self.still is not None or self.picture is not PictureKind.COLOUR

    @property
    def window_background(self) -> Colour:
        """The colour behind the Gaussians in a window, which has no transparency."""
        assert self.background is not TRANSPARENT  # __post_init__ made sure
        return self.background

    def _check_profile(self) -> None:
        if "://" in self.source:
            raise InvalidError(f"--profile needs a stream in a folder; {self.name} is a URL")
        given = ("--capture", self.capture is not None), ("--background", self.background != BLACK)
        self._refuse("--profile", *given, *self._of_plays)
