"""A training run from end to end: a capture folder in, a stream directory out."""

from __future__ import annotations

import hashlib
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro
from PIL import Image
from rich.console import Console

from codec.errors import InvalidError
from codec.framerange import FrameRange
from codec.profiles.profile import Profile
from codec.slice import Slice
from codec.splats import Splats
from codec.stream import StreamReader, StreamWriter
from codec.stream.manifest import Manifest
from player.render.cpu import render_splats
from trainer.capture.capture import Capture, check_trainable
from trainer.capture.layout import open_capture
from trainer.capture.points import points_evenness, read_points_file
from trainer.errors import CaptureError, InterruptedRunError
from trainer.fit.trainer import FALLBACK_FAR_M, FitConfig, Trainer
from trainer.pictures.feed import CapturePictures
from trainer.pictures.framecache import DEFAULT_MAX_BYTES, FrameCache
from trainer.score.evaluate import displayed
from trainer.score.quality import QualityMeter
from trainer.score.sheet import comparison, save_png
from trainer.seed.gaussians import initial_splats, stereo_seeds
from trainer.step.backend import BackendName

from . import checkpoint, runlog
from .checkpoint import load_checkpoint, save_checkpoint
from .monitor import Monitor, progress_bar
from .rank import CONTRIBUTION, matured_by_contribution, writer_rank
from .runlog import RunLog

FALLBACK_NEAR_M = 0.2
"""Near plane where a rig does not tell. 3DGS."""

LEAST_POINT_SHARE = 0.3
"""Of the first Gaussians, where points lie in a few spots only: those are what matters most."""


Preset = Literal["cpu", "fast", "paper"]


@dataclass(frozen=True)
class TrainConfig:
    """Trains a capture into a stream."""

    capture: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="CAPTURE")]
    """Folder of the recording: Dynamic 3D Gaussians, DyNeRF, COLMAP or nerfstudio layout."""
    stream: Annotated[tyro.conf.Positional[Path | None], tyro.conf.arg(metavar="STREAM")] = None
    """Folder to write; must not exist or be empty. Left out only with --check."""
    check: Annotated[Path | None, tyro.conf.arg(metavar="PNG")] = None
    """Train nothing: read the ends of every camera, say what was understood, and draw
    its cameras and points to this PNG."""
    preset: Preset = "cpu"
    """Defaults to start from: cpu (minutes on two cores), fast (a first look), or paper (its
    settings, made for a GPU); other options override them."""
    frames: str = ":"
    """Frames of the capture to train, A:B; A included, B not."""
    scale: float = 1.0
    """Size of the training pictures over the capture's, above 0 to 1."""
    near_m: float | None = None
    """Nearest depth drawn, metres; by default 0.35 of the cameras' distance to what they look
    at."""
    far_m: float | None = None
    """Depth that seeding reaches to, metres; by default from the rig."""
    points: Path | None = None
    """File of initial points, .ply or .npz, in the place of the capture's own."""
    point_share: float | None = None
    """Share of the first Gaussians taken from the capture's points, if it has any; seeds fill the
    rest. By default how evenly the points lie over the pictures (0 to 1), but 0.3 at least."""
    layers: tuple[float, ...] = (0.35, 0.15, 0.2, 0.3)
    """Share of a slice's Gaussians in each layer, most important first; the sum is 1. A smaller
    first layer leaves holes, and the last third of the Gaussians adds little."""
    rank: Literal["opacity", "coverage", "contribution"] = "contribution"
    """Importance that orders Gaussians into layers: contribution (blending weight summed over the
    training cameras; a first layer without holes), opacity (paper, section 5.5), or coverage
    (opacity times size)."""
    profile: Profile = Profile.COMPACT
    """Precision of the stream."""
    raw_stream: Path | None = None
    """Also write the same Gaussians with profile raw to this folder, to see what `profile`
    costs."""
    segment_frames: int = 15
    """Frames in a segment: what a writer can lose, and the unit of caching."""
    backend: BackendName = "cpu"
    """Where the steps of training are computed: cpu, cuda (gsplat on an NVIDIA GPU), or auto, which
    is cuda if it can. Ranks and scores are computed on the CPU."""
    resume: bool = False
    """Go on where a run of the same settings was stopped or killed."""
    log: Path | None = None
    """File that gets one JSON object per frame; by default training.jsonl in the stream folder."""
    tensorboard: Path | None = None
    """Also write the log's numbers as TensorBoard scalars to this folder."""
    snapshot_every: int = 30
    """Frames between pictures of a held-out view (capture, rendered, error), in snapshots/ in the
    stream's folder; 0 for none."""
    title: str = ""
    """Name of the stream for people; by default the capture folder's."""
    cache_bytes: int = DEFAULT_MAX_BYTES
    """Bytes of decoded pictures held in memory."""
    fit: Annotated[FitConfig, tyro.conf.arg(name="")] = field(default_factory=FitConfig)
    """The sliding-window training itself."""

    def __post_init__(self) -> None:
        if self.stream is None and self.check is None:
            raise InvalidError("name the folder to write the stream to, or --check PNG")
        if self.point_share is not None and not 0 <= self.point_share <= 1:
            raise InvalidError(f"point_share {self.point_share:g}: choose 0 to 1")
        if self.snapshot_every < 0:
            raise InvalidError(f"snapshot_every {self.snapshot_every}: choose 0 or more")

    @property
    def target(self) -> Path:
        """The folder to write."""
        if self.stream is None:
            raise InvalidError("no folder to write the stream to")
        return self.stream


def depths(capture: Capture, config: TrainConfig) -> tuple[float, float]:
    """Near and far depth in metres: as configured, else the capture's, else the fallbacks."""
    near_m = config.near_m
    if near_m is None:
        near_m = FALLBACK_NEAR_M if capture.near_m is None else capture.near_m
    far_m = config.far_m
    if far_m is None:
        far_m = max(FALLBACK_FAR_M, 10 * near_m) if capture.far_m is None else capture.far_m
    if not 0 < near_m < far_m:
        raise InvalidError(f"near_m {near_m:g} and far_m {far_m:g}: choose 0 < near_m < far_m")
    return near_m, far_m


def first_gaussians(
    capture: Capture, pictures: CapturePictures, config: TrainConfig, near_m: float, far_m: float
) -> Splats:
    """num_gs Gaussians: of the capture's points, the rest seeded where the cameras agree."""
    fit = config.fit
    rng = np.random.default_rng(fit.seed)
    positions, colours = np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8)
    if capture.points is not None:
        share = config.point_share
        if share is None:
            share = max(LEAST_POINT_SHARE, points_evenness(capture.points, pictures.cameras))
        count = min(len(capture.points), round(share * fit.num_gs))
        chosen = rng.choice(len(capture.points), count, replace=False)
        positions, colours = capture.points.xyz[chosen], capture.points.rgb[chosen]
    missing = fit.num_gs - len(positions)
    if missing > 0:
        cameras = pictures.cameras
        shots = [pictures.shot(c, 0) for c in range(len(cameras))]
        seeds, seed_colours = stereo_seeds(
            cameras, [s.picture for s in shots], missing, near_m, far_m, rng,
            [s.mask for s in shots],
        )  # fmt: skip
        if len(seeds) < missing:
            raise CaptureError(
                f"{capture.root}: no three training cameras see the same place between "
                f"{near_m:g} m and {far_m:g} m; set --near-m and --far-m"
            )
        positions = np.concatenate([positions, seeds])
        colours = np.concatenate([colours, seed_colours])
    return initial_splats(positions, colours, fit.sh_degree)


def make_manifest(
    capture: Capture, cache: FrameCache, initial: Splats, config: TrainConfig, near_m: float
) -> Manifest:
    """The manifest of the stream about to be trained."""
    cameras = tuple(cache.camera(i) for i in range(len(capture.cameras)))
    default = (capture.held_out or capture.training)[0]
    points = capture.points.xyz if capture.points is not None else initial.means
    low, high = np.percentile(points, 5, axis=0), np.percentile(points, 95, axis=0)
    return Manifest(
        fps=capture.fps,
        swin_size=config.fit.swin_size,
        num_gs=config.fit.num_gs,
        layers=config.layers,
        segment_frames=config.segment_frames,
        sh_degree=config.fit.sh_degree,
        profile=config.profile,
        antialias=False,
        near_m=near_m,
        bounds=(
            (float(low[0]), float(low[1]), float(low[2])),
            (float(high[0]), float(high[1]), float(high[2])),
        ),
        cameras=cameras,
        default_camera=cameras[default].name,
        live=True,
        title=config.title or capture.root.resolve().name,
        capture_frame=cache.frames.start,
    )


def check_targets(config: TrainConfig) -> list[Path]:
    """The folders to write. Raises InvalidError for one that holds something else, and for a log
    that has no place."""
    if config.log is not None and not config.log.parent.is_dir():
        raise InvalidError(f"{config.log.parent} is no folder; the log cannot be written there")
    targets = [config.target] + ([config.raw_stream] if config.raw_stream else [])
    for target in targets:
        if config.resume:
            continue
        if target.exists() and (not target.is_dir() or any(target.iterdir())):
            raise InvalidError(
                f"{target} exists and is not empty; remove it, name another folder, or --resume"
            )
    return targets


@dataclass(frozen=True, slots=True)
class Output:
    """A stream being written, and its quality."""

    writer: StreamWriter
    quality: QualityMeter


def open_outputs(
    targets: list[Path],
    manifest: Manifest,
    config: TrainConfig,
    capture: Capture,
    cache: FrameCache,
) -> list[Output]:
    """An output for each folder; a resumed run leaves out those that are finished."""
    outputs = []
    for target, profile in zip(targets, (manifest.profile, Profile.RAW), strict=False):
        quality = QualityMeter(capture, cache, manifest)
        if not config.resume:
            wanted = manifest.with_profile(profile)
            writer = StreamWriter.create(target, wanted, writer_rank(config.rank), quality=quality)
        else:
            reader = StreamReader(target)
            if not reader.manifest.live:
                continue
            writer = StreamWriter.resume(target, writer_rank(config.rank), quality=quality)
            quality.recall(reader, writer.next_birth)
        outputs.append(Output(writer, quality))
    if not outputs:
        raise InvalidError(f"{config.target} is finished; there is nothing to resume")
    return outputs


def settings(config: TrainConfig, frames: range, near_m: float, far_m: float) -> dict[str, Any]:
    """What a resumed run must share with the run that it continues."""
    return {
        **asdict(config.fit),
        "frames": [frames.start, frames.stop],
        "near_m": near_m,
        "far_m": far_m,
        **{
            name: getattr(config, name)
            for name in ("scale", "point_share", "layers", "rank", "profile", "segment_frames")
        },
        "raw_stream": config.raw_stream is not None,
    }


def fingerprint(capture: Capture, frame: int) -> str:
    """Of one picture: tells the takes of one rig apart."""
    source = capture.open_images(capture.training[0])
    try:
        return hashlib.sha256(source.read(frame).tobytes()).hexdigest()
    finally:
        source.close()


@contextmanager
def interruptible() -> Iterator[threading.Event]:
    """Ctrl-C sets the event, so that the running window can end; a second one ends at once."""
    asked = threading.Event()

    def stop(number: int, frame: object) -> None:
        if asked.is_set():
            raise KeyboardInterrupt
        asked.set()

    if threading.current_thread() is not threading.main_thread():
        yield asked
        return
    before = signal.signal(signal.SIGINT, stop)
    try:
        yield asked
    finally:
        signal.signal(signal.SIGINT, before)


def train_stream(
    config: TrainConfig, console: Console, on_checked: Callable[[], None] = lambda: None
) -> Manifest:
    """Trains `config.capture` into `config.stream`; progress goes to `console`.

    on_checked: called when capture and settings were found good, before anything is computed.

    Raises SwingsError before anything is written when the capture or the settings cannot work; what
    stops it later leaves a valid, shorter stream and a checkpoint to resume from.
    """
    capture = open_capture(config.capture)
    if config.points is not None:
        capture = replace(capture, points=read_points_file(config.points))
    check_trainable(capture)
    frames = FrameRange.parse(config.frames).of(capture.num_frames, capture.root)
    targets = check_targets(config)
    near_m, far_m = depths(capture, config)
    backend = config.fit.backend(config.backend)
    shared = settings(config, frames, near_m, far_m) | {
        "backend": type(backend).__name__,
        "first_picture": fingerprint(capture, frames.start),
    }
    kept = config.target / checkpoint.NAME
    found = load_checkpoint(kept, shared) if config.resume else None
    on_checked()
    with ExitStack() as stack:
        cache = stack.enter_context(FrameCache(capture, frames, config.scale, config.cache_bytes))
        pictures = CapturePictures(cache, capture.training)
        log = stack.enter_context(
            RunLog(config.log or config.target / runlog.NAME, config.tensorboard)
        )
        if found is None:
            with console.status("first Gaussians"):
                initial = first_gaussians(capture, pictures, config, near_m, far_m)
            manifest = make_manifest(capture, cache, initial, config, near_m)
            trainer = Trainer(config.fit, pictures, initial, near_m, far_m, backend=backend)
        else:
            manifest = StreamReader(config.target).manifest
            trainer = Trainer(config.fit, pictures, None, near_m, far_m, backend=backend)
            trainer.restore(found.state)
        outputs = open_outputs(targets, manifest, config, capture, cache)
        writers = [stack.enter_context(output.writer) for output in outputs]
        pending: list[Slice] = []
        if found is not None:
            deliver(found.pending, writers, pending)
        else:
            save_checkpoint(kept, trainer.state(), pending, shared)
        bar = stack.enter_context(progress_bar(console))
        monitor = Monitor(bar, log, config.fit, len(frames), trainer.next_window)
        trainer.on_progress = monitor.on_progress
        first, swin_size = trainer.next_window, config.fit.swin_size
        for frame in range(first, first + swin_size + 1):
            pictures.prefetch(frame, first)
        asked = stack.enter_context(interruptible())
        for parts in trainer.windows():
            # While the next window is trained, what the one after it brings is read. The frame that
            # was just finished is still scored.
            pictures.prefetch(trainer.next_window + swin_size, trainer.next_window - 1)
            if config.rank == CONTRIBUTION:
                parts = matured_by_contribution(trainer, parts)
            deliver(parts, writers, pending)
            save_checkpoint(kept, trainer.state(), pending, shared)
            frame = trainer.next_window - 1
            shown = len(trainer.lifespans.active_rows(frame))
            monitor.on_frame(frame, shown, writers[0].bytes_written, outputs[0].quality)
            if config.snapshot_every and frame % config.snapshot_every == 0:
                write_snapshot(trainer, capture, cache, near_m, config.target / "snapshots")
            if asked.is_set() and trainer.next_window < len(frames):
                raise InterruptedRunError(
                    f"stopped after frame {frame}; --resume goes on from there"
                )
    kept.unlink()
    return manifest


def write_snapshot(
    trainer: Trainer, capture: Capture, cache: FrameCache, near_m: float, folder: Path
) -> None:
    """Draws the newest finished frame as the first held-out camera sees it to a PNG in `folder`."""
    frame = trainer.next_window - 1
    index = (capture.held_out or capture.training)[0]
    splats = trainer.shown(frame)
    truth = cache.image(index, cache.frames[frame]).astype(np.float32) / np.float32(255)
    seen = displayed(render_splats(splats, cache.camera(index), near_m))
    save_png(Image.fromarray(comparison(seen, truth)), folder / f"{frame:06d}.png")


def deliver(parts: list[Slice], writers: list[StreamWriter], pending: list[Slice]) -> None:
    """Appends `parts` where they are still missing; `pending` keeps what no file holds yet."""
    for part in parts:
        for writer in writers:
            if part.birth >= writer.next_birth:
                writer.append(part)
        pending.append(part)
    pending[:] = [p for p in pending if any(p.birth >= w.durable_birth for w in writers)]
