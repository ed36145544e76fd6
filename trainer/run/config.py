"""The settings of a training run; its `--help` is made of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from codec.errors import InvalidError
from codec.profiles.profile import Profile
from codec.storage.openstorage import Target, is_url
from codec.storage.targetargument import target_named
from codec.stream.manifest import MAX_FPS, MIN_FPS
from trainer.fit.config import FitConfig
from trainer.pictures.framecache import DEFAULT_MAX_BYTES
from trainer.step.backend import BackendName


def default_work(target: Target) -> Path:
    """The work folder of a run that is not told one."""
    if not is_url(target):
        return Path(target)
    return Path(str(target).rstrip("/").rpartition("/")[2] + ".work")


LOCAL = "local"
"""In place of the address of a Ray cluster: one of this machine alone, for one run."""

Preset = Literal["cpu", "fast", "fine", "paper"]


@dataclass(frozen=True)
class TrainConfig:
    """Trains a capture into a stream."""

    capture: tyro.conf.Positional[Annotated[Target, target_named("CAPTURE")]]
    """Folder of the recording, or its URL in an object store, as s3://BUCKET/PATH: Dynamic 3D
    Gaussians, DyNeRF, COLMAP or nerfstudio layout."""
    stream: tyro.conf.Positional[Annotated[Target | None, target_named("STREAM")]] = None
    """Folder to write, new or empty, or a URL. Left out only with --check."""
    work: Path | None = None
    """Folder for what is not for players: checkpoint, log and snapshots. By default the stream's
    folder; for a URL NAME.work here, after its last part."""
    check: Annotated[Path | None, tyro.conf.arg(metavar="PNG")] = None
    """Train nothing: read the first and the last frame of every camera, say what was understood,
    and draw cameras and points to this PNG."""
    preset: Preset = "cpu"
    """Defaults to start from: cpu (minutes on two cores), fast (a first look), fine (an hour or
    two), or paper (its settings, made for a GPU); other options override them."""
    frames: str = ":"
    """Frames of the capture to train, A:B; A included, B not."""
    scale: float = 1.0
    """Size of the training pictures over the capture's, above 0 to 1."""
    fps: float | None = None
    """Frames per second, where no file of the capture tells them, or in place of what it tells."""
    near_m: float | None = None
    """Nearest depth drawn, in the capture's unit; by default 0.35 of the cameras' distance to what
    they look at, or less where they see something nearer (--check says)."""
    far_m: float | None = None
    """Depth that seeding reaches to, in the capture's unit; by default from the rig."""
    points: Path | None = None
    """File of initial points, .ply or .npz, in place of the capture's own."""
    point_share: float | None = None
    """Share of the first Gaussians taken from the capture's points, if it has any; seeds fill the
    rest. By default how evenly the points lie over the pictures (0 to 1), but 0.3 at least."""
    initial: Path | None = None
    """Gaussians of the first frame, trained elsewhere or exported from a stream, in place of points
    and seeds: a .ply, .splat or .spz with num_gs of them. With --genesis-iterations 0 they only
    settle."""
    layers: tuple[float, ...] = (0.35, 0.15, 0.2, 0.3)
    """Share of a slice's Gaussians in each layer, most important first; the sum is 1. A smaller
    first layer leaves holes, and the last third of the Gaussians adds little."""
    rank: Literal["opacity", "coverage", "contribution"] = "contribution"
    """Importance that orders Gaussians into layers: contribution (blending weight summed over the
    training cameras; a first layer without holes), opacity (paper, section 5.5), or coverage
    (opacity times size)."""
    profile: Profile = Profile.LATTICE
    """How the stream says its Gaussians: lattice (what stands still is sent once, what goes on as a
    difference), or slices sent whole in one of three precisions: compact, paper, raw."""
    raw_stream: Annotated[Target | None, target_named("STREAM")] = None
    """Folder or URL for a second stream, of the same Gaussians with profile raw: shows what
    `profile` costs."""
    segment_frames: int = 15
    """Frames in a segment: what a writer can lose, and the unit of caching."""
    backend: BackendName = "cpu"
    """Where the steps of training are computed: cpu (numba), cuda (gsplat on an NVIDIA GPU), torch
    (plain torch on any of its devices), or auto, the best that works: cuda, else torch on a GPU,
    else cpu. Ranks and scores are computed on the CPU."""
    torch_device: str | None = None
    """Device of backend torch, in torch's words: cuda:1, xpu, mps, cpu; by default a GPU if torch
    has one."""
    ray: Annotated[str | None, tyro.conf.arg(metavar="[ADDRESS]")] = None
    """Train parts of the capture side by side on the Ray cluster at ADDRESS, as auto or HOST:PORT;
    without an address on this machine alone. Capture and stream must be where all of its nodes
    find them: in an object store, or in a folder that they share."""
    worker_cpus: float = 2
    """With --ray: cores that a worker claims, of those that the cluster has, and threads that it
    trains with."""
    worker_gpus: float = 0
    """With --ray: GPUs that a worker claims; below 1 where several share one. Backends cuda and
    torch need some; see docs/SCALE.md."""
    part_frames: int = 300
    """With --ray: frames of a part, which one worker trains after another; rounded up to whole
    segments."""
    warm_frames: int = 30
    """With --ray: frames before a part in which it learns what has changed since the first."""
    seam_frames: int = 30
    """With --ray: frames in which a part takes over from the one before, rounded up to whole
    segments; they are trained twice."""
    resume: bool = False
    """Go on where the run that wrote STREAM was stopped or killed, with its settings. Options that
    are given must be the same as then, but for those that change no byte of the stream."""
    log: Path | None = None
    """File that gets one JSON object per frame; by default training.jsonl in the work folder."""
    tensorboard: Path | None = None
    """Also write the log's numbers as TensorBoard scalars to this folder."""
    snapshot_every: int = 30
    """Frames between pictures of a held-out view (capture, rendered, error), in snapshots/ in the
    work folder; 0 for none."""
    title: str = ""
    """Name of the stream for people; by default the capture folder's."""
    cache_bytes: int = DEFAULT_MAX_BYTES
    """Bytes of decoded pictures held in memory."""
    fit: Annotated[FitConfig, tyro.conf.arg(name="")] = field(default_factory=FitConfig)
    """The sliding-window training itself."""

    def __post_init__(self) -> None:
        if self.stream is None and self.check is None:
            raise InvalidError("name the folder to write the stream to, or --check PNG")
        if not 0 < self.scale <= 1:
            raise InvalidError(f"scale {self.scale:g}: choose above 0, at most 1")
        if self.fps is not None and not MIN_FPS <= self.fps <= MAX_FPS:
            raise InvalidError(f"fps {self.fps:g}: choose {MIN_FPS:g} to {MAX_FPS:g}")
        if self.point_share is not None and not 0 <= self.point_share <= 1:
            raise InvalidError(f"point_share {self.point_share:g}: choose 0 to 1")
        if self.snapshot_every < 0:
            raise InvalidError(f"snapshot_every {self.snapshot_every}: choose 0 or more")
        if not self.worker_cpus > 0:
            raise InvalidError(f"worker_cpus {self.worker_cpus:g}: choose above 0")
        if not self.worker_gpus >= 0:
            raise InvalidError(f"worker_gpus {self.worker_gpus:g}: choose 0 or more")

    def check_profile(self) -> None:
        """Raises InvalidError for an option that the profile leaves without a meaning. Not part of
        making a config, where the parser of the command line would put a box around the line."""
        if self.profile is not Profile.LATTICE:
            return
        if self.raw_stream is not None:
            raise InvalidError(
                "--raw-stream shows what a profile costs, and with lattice the trainer sees "
                "nothing else; train with --profile compact"
            )
        if self.rank != "contribution":
            raise InvalidError(
                f"--rank {self.rank} orders slices that are sent whole, and with lattice slots "
                "are ranked by contribution; leave it out, or train with --profile compact"
            )

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
