"""The settings of a training run; its `--help` is made of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import tyro

from codec.errors import InvalidError
from codec.helptext import Groups
from codec.storage.openstorage import Target, is_url
from codec.storage.targetargument import target_named
from codec.stream.manifest import MAX_FPS, MIN_FPS
from trainer.capture.camerachoice import CameraChoice
from trainer.capture.layouts import listed_titles
from trainer.fit.config import FitConfig
from trainer.pictures.framecache import DEFAULT_MAX_BYTES
from trainer.step.backend import BackendName


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
                f"s3://BUCKET/PATH. Its layout is that of {listed_titles()}."
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
    """Set of defaults: cpu (minutes on two cores), fast (a first look), fine (an hour or two on two
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
