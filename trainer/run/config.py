"""The settings of a training run, of which its `--help` is made; presets, whose defaults every
option overrides; and the settings as JSON, so that a resumed run needs no options.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import partial
from pathlib import Path
from types import UnionType
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import tyro

from codec.console import cli, split_option
from codec.errors import InvalidError
from codec.helptext import Groups
from codec.storage.openstorage import Target, is_url, parse_target, target_named
from codec.stream.manifest import MAX_FPS, MIN_FPS
from trainer.capture.capture import CameraChoice
from trainer.capture.layouts import listed_titles
from trainer.errors import CheckpointError
from trainer.fit.config import FitConfig
from trainer.fit.mcmc import McmcConfig
from trainer.lease.leases import LeaseConfig
from trainer.pictures.framecache import DEFAULT_MAX_BYTES
from trainer.step.backend import BackendName
from trainer.step.optimiser import OptimiserConfig

from .checkpoint import read_options


def default_work(target: Target) -> Path:
    """The work folder of a run without --work."""
    if not is_url(target):
        return Path(target)
    return Path(str(target).rstrip("/").rpartition("/")[2] + ".work")


LOCAL = "local"
"""In place of the address of a Ray cluster: one of this machine alone, for one run."""

Preset = Literal["cpu", "fast", "fine", "gpu", "paper"]


@dataclass(frozen=True)
class TrainConfig:
    """Trains a capture into a stream."""

    EVERYDAY: ClassVar[Groups] = {
        "Capture": ("check", "frames", "scale", "longest-px", "without-cameras", "fps", "audio"),
        "Quality and time": ("preset", "num-gs", "sh-degree", "backend"),
        "Stream": ("title", "default-camera", "layers", "segment-frames"),
        "While it trains": ("serve", "resume", "work"),
        "Many machines": ("ray", "worker-cpus", "worker-gpus"),
    }

    capture: tyro.conf.Positional[
        Annotated[
            Target,
            target_named("CAPTURE"),
            tyro.conf.arg(
                help="Folder of the capture, or its URL in an object store, such as "
                f"s3://BUCKET/PATH. Its layout is that of {listed_titles()}; plain videos, one a "
                "camera, become the capture STREAM-capture first."
            ),
        ]
    ]
    stream: tyro.conf.Positional[Annotated[Target | None, target_named("STREAM")]] = None
    """Folder to write, new or empty, or a URL. May be left out only with --check."""
    work: Path | None = None
    """Folder for the files that players do not need: checkpoint, log and snapshots. By default the
    stream's folder; for a URL NAME.work in the current folder, NAME being the URL's last part."""
    check: Annotated[Path | None, tyro.conf.arg(metavar="PNG")] = None
    """Check the capture instead of training: read the first and the last frame of every camera,
    describe the capture, and draw its cameras and points to this PNG."""
    preset: Preset = "cpu"
    """Set of defaults: cpu (minutes on two cores), fast (a first look), fine (over an hour on two
    cores), gpu (200,000 Gaussians on a GPU), or paper (the paper's settings, made for a GPU). Other
    options override them."""
    frames: Annotated[str, tyro.conf.arg(metavar="A:B")] = ":"
    """Range of frames of the capture to train, A:B, A included, B not."""
    scale: float = 1.0
    """Size of the training pictures relative to the capture's, above 0 to 1."""
    longest_px: int | None = 640
    """Longest side of the training pictures, pixels: those of a larger capture are scaled down to
    it. A number above the capture's keeps its size."""
    without_cameras: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME [NAME ...]")] = ()
    """Names of cameras of the capture to leave out, such as one that is out of step."""
    fps: float | None = None
    """Frames per second, if no file of the capture gives them, or to override them."""
    near_m: float | None = None
    """Nearest depth drawn, in the capture's unit. By default 0.35 of the distance from the cameras
    to the point that they look at, or less if they see something nearer, and in the view of each
    camera by what it sees itself (--check prints it)."""
    far_m: float | None = None
    """Largest depth at which seeds are placed, in the capture's unit; by default derived from the
    rig."""
    points: Path | None = None
    """File of initial points, .ply or .npz, used instead of the capture's own points."""
    point_share: float | None = None
    """Share of the first Gaussians taken from the capture's points, if it has any; seeds are used
    for the rest. By default the evenness of the points over the pictures (0 to 1), but at least
    0.3."""
    initial: Path | None = None
    """File of the first frame's Gaussians (.ply, .splat or .spz), trained elsewhere or exported
    from a stream, used instead of points and seeds. It must hold num_gs Gaussians. With
    --genesis-iterations 0 they run through the settling rounds only."""
    layers: tuple[float, ...] = (0.35, 0.15, 0.2, 0.3)
    """Share of a slice's Gaussians in each layer, most important first; the sum is 1. A smaller
    first layer leaves holes, and the last third of the Gaussians adds little."""
    audio: Path | None = None
    """File with the sound of the capture (WAV, FLAC, Opus, or a video), from its frame 0 on. By
    default the sound of the first of the capture's videos that has any."""
    silent: bool = False
    """Leave out the sound of the capture's videos."""
    rank: Literal["opacity", "coverage", "contribution"] = "contribution"
    """Importance that orders Gaussians into layers: contribution (blending weight summed over the
    training cameras; leaves no holes in the first layer), opacity (paper, section 5.5), or coverage
    (opacity times size)."""
    whole_slices: bool = False
    """Send all Gaussians of a slice in every slice, as the paper does. Otherwise
    still Gaussians are sent once, and moving ones as differences."""
    raw_stream: Annotated[Target | None, target_named("STREAM")] = None
    """Folder or URL of a second stream, with every float of the same Gaussians, to measure the loss
    that quantising them causes. Needs --whole-slices."""
    segment_frames: int = 15
    """Number of frames in a segment. A segment is the most that a stopped writer can lose, and the
    unit of caching."""
    backend: BackendName = "cpu"
    """Backend that computes the training steps: cpu (numba), cuda (gsplat on an NVIDIA GPU), torch
    (plain torch on any of its devices), or auto, the best that works: cuda, else torch on a GPU,
    else cpu. Ranks and scores are always computed on the CPU."""
    torch_device: str | None = None
    """Device of backend torch, as torch names it: cuda:1, xpu, mps, cpu; by default a GPU if torch
    has one."""
    ray: Annotated[str | None, tyro.conf.arg(metavar="[ADDRESS]")] = None
    """Train parts of the capture in parallel on the Ray cluster at ADDRESS (auto or HOST:PORT);
    without an address, on this machine alone. All nodes must be able to open the capture and the
    stream: in an object store, or in a folder that the nodes share."""
    worker_cpus: float = 2
    """With --ray: CPU cores that each worker reserves in the cluster, and its number of threads."""
    worker_gpus: float = 0
    """With --ray: GPUs that each worker reserves; below 1 if several workers share one GPU.
    Backends cuda and torch need more than 0; see docs/OPERATE.md."""
    part_frames: int = 300
    """With --ray: number of frames in a part, rounded up to whole segments. One worker trains the
    frames of a part one after another."""
    warm_frames: int = 30
    """With --ray: number of frames before a part in which its worker learns the changes since the
    first frame."""
    seam_frames: int = 30
    """With --ray: number of frames in which a part takes over from the previous part, rounded up to
    whole segments. Both parts train these frames."""
    resume: bool = False
    """Continue a stopped or killed run where it stopped, with its settings. Options given here must
    equal those of that run, except options that change no byte of the stream."""
    log: Path | None = None
    """Log file, one JSON object per frame; by default training.jsonl in the work folder."""
    tensorboard: Path | None = None
    """Also write the log's numbers as TensorBoard scalars to this folder."""
    snapshot_every: int = 30
    """Frames between pictures of a held-out view (capture, rendered, error) in snapshots/ in the
    work folder; 0 draws none."""
    serve: Annotated[int | None, tyro.conf.arg(metavar="PORT")] = None
    """Serve the stream on this port of this machine while it is trained, for the browser player; 0
    picks a free port. The server ends with the run. It logs to serve.log in the work folder."""
    title: str = ""
    """Title of the stream; by default the name of the capture's folder."""
    default_camera: Annotated[str | None, tyro.conf.arg(metavar="CAMERA")] = None
    """Name of the camera that the stream opens with, and whose view its poster shows; by default
    the most central of those to train on with the commonest size of picture."""
    cache_bytes: int = DEFAULT_MAX_BYTES
    """Largest size of the decoded pictures held in memory, bytes."""
    fit: Annotated[FitConfig, tyro.conf.arg(name="")] = field(default_factory=FitConfig)
    """Settings of the sliding-window training."""

    def __post_init__(self) -> None:
        if self.stream is None and self.check is None:
            raise InvalidError("name the folder to write the stream to, or --check PNG")
        if not 0 < self.scale <= 1:
            raise InvalidError(f"scale {self.scale:g}: choose above 0, at most 1")
        if self.longest_px is not None and self.longest_px < 1:
            raise InvalidError(f"longest_px {self.longest_px}: choose 1 or more")
        if self.fps is not None and not MIN_FPS <= self.fps <= MAX_FPS:
            raise InvalidError(f"fps {self.fps:g}: choose {MIN_FPS:g} to {MAX_FPS:g}")
        if self.point_share is not None and not 0 <= self.point_share <= 1:
            raise InvalidError(f"point_share {self.point_share:g}: choose 0 to 1")
        if self.audio is not None and self.silent:
            raise InvalidError("--audio cannot be combined with --silent")
        if self.serve is not None and not 0 <= self.serve <= 65535:
            raise InvalidError(f"serve {self.serve}: choose a port, 0 to 65535")
        if self.snapshot_every < 0:
            raise InvalidError(f"snapshot_every {self.snapshot_every}: choose 0 or more")
        if not self.worker_cpus > 0:
            raise InvalidError(f"worker_cpus {self.worker_cpus:g}: choose above 0")
        if not self.worker_gpus >= 0:
            raise InvalidError(f"worker_gpus {self.worker_gpus:g}: choose 0 or more")

    def check_slices(self) -> None:
        """Raises InvalidError for an option that only whole slices give a meaning. Not part of
        making a config, where the parser of the command line would put a box around the line."""
        if self.whole_slices:
            return
        if self.raw_stream is not None:
            raise InvalidError(
                "--raw-stream shows what quantising costs, but slots that last are trained as they "
                "are coded; add --whole-slices"
            )
        if self.rank != "contribution":
            raise InvalidError(
                f"--rank {self.rank} orders slices that are sent whole, but slots that last are "
                "ranked by contribution; leave it out, or add --whole-slices"
            )

    @property
    def choice(self) -> CameraChoice:
        """Which cameras of the capture to open."""
        return CameraChoice(self.without_cameras)

    @property
    def target(self) -> Target:
        """The folder or URL to write."""
        if self.stream is None:
            raise InvalidError("no folder to write the stream to")
        return self.stream

    @property
    def work_folder(self) -> Path:
        """Where what the run needs besides the stream is written."""
        return self.work if self.work is not None else default_work(self.target)


Config = TypeVar("Config")


def config_to_json(config: Any) -> dict[str, Any]:
    """The fields of a dataclass, of those in it too. Paths are absolute: a run may be resumed from
    another folder."""
    return {f.name: _to_json(getattr(config, f.name)) for f in dataclasses.fields(config)}


def _to_json(value: Any) -> Any:
    if dataclasses.is_dataclass(value):
        return config_to_json(value)
    if isinstance(value, Path):
        return str(value.absolute())
    if isinstance(value, Enum):
        return value.value
    return list(value) if isinstance(value, tuple) else value


def config_from_json(config_type: type[Config], values: Any) -> Config:
    """The opposite of `config_to_json`. A field that `values` lack has its default.

    Raises TypeError or ValueError, InvalidError among them, for values that make no such config.
    """
    if not isinstance(values, Mapping):
        raise TypeError(f"{values!r} holds no settings")
    types = get_type_hints(config_type)
    unknown = values.keys() - types.keys()
    if unknown:
        raise ValueError(f"no setting is called {min(unknown)}")
    return config_type(**{name: _from_json(types[name], v) for name, v in values.items()})


def _from_json(wanted: Any, value: Any) -> Any:
    if get_origin(wanted) in (Union, UnionType):
        if value is None:
            return None
        if {str, Path} <= set(get_args(wanted)):
            return parse_target(value)
        wanted = next(kind for kind in get_args(wanted) if kind is not type(None))
    if get_origin(wanted) is tuple:
        return tuple(value)
    if isinstance(wanted, type):
        if dataclasses.is_dataclass(wanted):
            return config_from_json(wanted, value)
        if issubclass(wanted, Path | Enum):
            return wanted(value)
    return value


PRESETS: Mapping[Preset, Callable[..., TrainConfig]] = {
    # The defaults: what two cores train in minutes. Measured in docs/RESULTS.md.
    "cpu": TrainConfig,
    # A first look at a capture: a third of the iterations and half of the Gaussians of `cpu`.
    "fast": partial(
        TrainConfig,
        preset="fast",
        longest_px=480,
        fit=FitConfig(
            num_gs=10_000,
            genesis_iterations=1_500,
            settle_rounds=8,
            window_iterations=150,
            scene_flow=True,  # so few iterations leave a ghost where a ball was
        ),
    ),
    # Two cores train 150 frames of 640x360 with it in over an hour. docs/RESULTS.md.
    "fine": partial(
        TrainConfig,
        preset="fine",
        longest_px=None,
        layers=(0.475, 0.155, 0.155, 0.215),
        fit=FitConfig(
            num_gs=19_000,
            settle_rounds=60,
            window_iterations=520,
            window_coarse_share=0.4,  # saves a fifth of the time, costs some flicker
            scene_flow=True,
            settle_base_share=0.33,
            settle_prefix_share=0.1,
            prefix_share=0.25,
            dssim_weight=0.35,  # 0.2 dB better on held-out cameras than 0.2
            mcmc=McmcConfig(renew_share=0.01),  # a renewed Gaussian costs two predicted ones
            lease=LeaseConfig(active_share=0.265),
        ),
    ),
    # What a GPU should train in seconds a frame at 1352x1014, the size at which DyNeRF captures are
    # compared. Not measured: see docs/RESULTS.md for the command.
    "gpu": partial(
        TrainConfig,
        preset="gpu",
        backend="auto",
        longest_px=1352,
        fit=FitConfig(
            num_gs=200_000,
            genesis_iterations=9_000,
            settle_rounds=20,
            window_iterations=600,
        ),
    ),
    # The paper's setting, made for a GPU: section 8.1 and, where it is silent, 3DGS-MCMC, on which
    # it builds.
    "paper": partial(
        TrainConfig,
        preset="paper",
        longest_px=None,
        fit=FitConfig(
            num_gs=200_000,  # 8.1
            swin_size=5,  # 8.1
            sh_degree=1,  # 8.1
            genesis_iterations=30_000,  # 8.1
            window_iterations=2_000,  # 8.1
            settle_rounds=0,  # not in the paper
            calm_from=1.0,  # not in the paper
            coarse_share=0.0,  # not in the paper
            newest_share=0.0,  # Algorithm 1: frames of the window evenly
            colour_lr=0.0,  # not in the paper
            optimiser=OptimiserConfig(
                window_means_lr=1.6e-4,  # 3DGS-MCMC, again for every window
                window_means_lr_end=1.6e-6,
                age_scaling="gradient",  # 4.5.1
            ),
            mcmc=McmcConfig(
                renew_share=0.0,  # not in the paper
                opacity_reg=0.02,  # 8.1
                scale_reg=0.01,  # 8.1
                max_scale=0.0,  # not in the paper
            ),
        ),
        point_share=1.0,  # 3DGS: a capture's points and nothing else, as far as they go
        rank="opacity",  # 5.5
        whole_slices=True,
    ),
}
"""TrainConfig with other defaults."""


def parse_with_preset(
    config_type: Callable[..., TrainConfig], args: Sequence[str], **options: Any
) -> TrainConfig:
    """Calls `cli` with the defaults of the preset that `args` name, if any; where they ask to
    resume a run, with that run's settings.

    An unknown name is left to tyro to refuse.
    """
    config: TrainConfig
    args = _with_address(args)
    before = _resumed(args) if "--resume" in args else None
    if before is not None:
        config = cli(TrainConfig, default=before, args=args, **options)
        return config
    preset, _ = split_option(args, "--preset", nargs="?")
    config = cli(PRESETS.get(preset, config_type), args=args, **options)
    return config


def _with_address(args: Sequence[str]) -> list[str]:
    """`args` with the address that --ray leaves out."""
    given = list(args)
    if "--ray" in given:
        after = given.index("--ray") + 1
        if after == len(given) or given[after].startswith("-"):
            given.insert(after, LOCAL)
    return given


def _resumed(args: Sequence[str]) -> TrainConfig | None:
    """The settings of the run whose folder is among `args`; None if there is none, or if they
    cannot be read, which is reported later."""
    # Before parsing, which needs them: of what is given, a part may be wrong without the rest.
    folders = [default_work(parse_target(word)) for word in args if not word.startswith("-")]
    try:
        kept = next((options for f in folders if (options := read_options(f)) is not None), None)
        return None if kept is None else config_from_json(TrainConfig, kept)
    except (CheckpointError, TypeError, ValueError):
        return None
