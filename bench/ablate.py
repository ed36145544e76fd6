"""Effect of the paper's choices: age scaling (its Table 5) with Adam's history carried or fresh,
and swin_size against num_gs at equal bandwidth (its Figure 7 and Equation 4).

Usage: scripts/bench ablate CAPTURE --out docs/ablate.png --scale 0.5

Every setting is trained once per seed and scored from its decoded files on the held-out cameras.
Finished runs are kept as JSON in --work, so that an interrupted measurement continues; empty that
folder after a change of the trainer. `scripts/bench leases` measures slots and leases.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, get_args

os.environ.setdefault("OMP_WAIT_POLICY", "passive")

import matplotlib.axes
import matplotlib.backends.backend_agg
import matplotlib.figure
import numpy as np
import tyro
from rich import box
from rich.console import Console
from rich.table import Table

from codec.console import run_command
from codec.errors import InvalidError
from codec.files import write_atomic
from codec.framerange import FrameRange
from codec.stream import StreamReader
from trainer.capture.layout import open_capture
from trainer.fit.config import FitConfig
from trainer.run.config import TrainConfig
from trainer.run.job import train_stream
from trainer.score.evaluate import EvaluateConfig, evaluate_stream
from trainer.step.optimiser import AgeScaling

AGE_SCALINGS: tuple[AgeScaling, ...] = get_args(AgeScaling)
CARRIED = {True: "carried", False: "fresh"}
COLOURS = {True: "#1f5fbf", False: "#d9480f"}
"""Colours of the lines: Adam's history carried or fresh."""


@dataclass(frozen=True)
class TrialsConfig:
    """Runs of one capture with different settings."""

    capture: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="CAPTURE")]
    """Folder of the capture."""
    work: Path = field(default_factory=lambda: Path(tempfile.gettempdir()) / "swings-ablate")
    """Folder that keeps the results of finished runs."""
    frames: str = "0:12"
    """Frames of the capture to train, A:B; A included, B not."""
    fps: float | None = None
    """Frames per second, if no file of the capture states them."""
    scale: float = 0.5
    """Size of the training pictures relative to the capture's."""
    genesis_iterations: int = 1500
    """Iterations of the first window, before it settles."""
    window_iterations: int = 250
    """Iterations of every later window."""
    seeds: int = 2
    """Runs of each setting, one per seed; their spread shows which differences are significant."""


@dataclass(frozen=True)
class AblateConfig(TrialsConfig):
    """Trains a capture with one choice changed at a time; tabulates and draws the results."""

    out: Path = Path("docs/ablate.png")
    """The plot to write."""
    age_num_gs: int = 10_000
    """Gaussians active in a frame in the comparison of age scaling."""
    age_swin_size: int = 5
    """Lifetime of a Gaussian in the comparison of age scaling, frames."""
    swin_sizes: tuple[int, ...] = (1, 2, 3, 5)
    """Lifetimes of a Gaussian to compare at equal bandwidth, frames."""
    slice_size: int = 5_000
    """Gaussians sent per frame in the comparison of swin_size; num_gs is swin_size times this."""


AGE, SIZE = "age scaling", "swin_size"
"""The comparisons."""


@dataclass(frozen=True, slots=True)
class Setting:
    """A row of the table."""

    group: str
    """The comparison that it belongs to; the others of it are compared with its first setting."""
    name: str
    fit: FitConfig
    whole_slices: bool = False
    layers: tuple[float, ...] = TrainConfig.layers
    """Share of the Gaussians in each layer."""

    @property
    def carried(self) -> bool:
        """Whether Adam's history is carried from window to window."""
        return self.fit.optimiser.carry_adam


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of one run, with all layers; means over held-out cameras and frames."""

    psnr_db: float
    moving_db: float | None
    ssim: float
    flicker: float | None
    bytes_per_frame: float
    """Bytes of one slice; in a short run the keyframe of frame 0 would weigh too much."""
    layers_db: list[float]
    """PSNR with 1, 2, ... layers."""
    layers_bytes: list[float]
    """Bytes per frame with 1, 2, ... layers, of everything that a player starting at frame 0
    fetches."""
    seconds: float
    """Duration of the training."""
    more: dict[str, float] = field(default_factory=dict)
    """Other figures measured on the stream."""


Outcomes = Mapping[Setting, Sequence[Outcome]]
"""The outcomes of each setting, one for each seed."""

Examine = Callable[[StreamReader], dict[str, float]]
"""Computes `Outcome.more` of a stream."""


def nothing_more(reader: StreamReader) -> dict[str, float]:
    return {}


def settings(config: AblateConfig) -> list[Setting]:
    """All settings send whole slices and train as in the paper."""
    base = FitConfig(
        num_gs=config.age_num_gs,
        swin_size=config.age_swin_size,
        genesis_iterations=config.genesis_iterations,
        settle_rounds=0,
        window_iterations=config.window_iterations,
        calm_from=1.0,
    )
    found = []
    for carried, told in CARRIED.items():
        for age_scaling in AGE_SCALINGS:
            optimiser = replace(base.optimiser, age_scaling=age_scaling, carry_adam=carried)
            fit = replace(base, optimiser=optimiser)
            name = f"age scaling {age_scaling}, Adam {told}"
            found.append(Setting(AGE, name, fit, whole_slices=True))
    for swin_size in config.swin_sizes:
        fit = replace(base, swin_size=swin_size, num_gs=swin_size * config.slice_size)
        name = f"swin_size {swin_size}, {fit.num_gs:,} Gaussians"
        found.append(Setting(SIZE, name, fit, whole_slices=True))
    return found


def training(config: TrialsConfig, setting: Setting, stream: Path) -> TrainConfig:
    return TrainConfig(
        config.capture.resolve(),
        stream,
        frames=config.frames,
        fps=config.fps,
        scale=config.scale,
        whole_slices=setting.whole_slices,
        layers=setting.layers,
        fit=setting.fit,
    )


def slice_bytes(reader: StreamReader) -> float:
    """Mean bytes of a slice, skip maps and changes. The slice of frame 0 is empty and not
    counted."""
    records = reader.records
    skip_maps = sum(record.side_bytes[0] for record in records)
    changes = sum(sum(record.object_bytes) for record in records)
    return (skip_maps + changes) / max(reader.num_frames - 1, 1)


def measure_once(config: TrialsConfig, setting: Setting, examine: Examine) -> Outcome:
    """Trains into a temporary folder and scores its files."""
    with tempfile.TemporaryDirectory() as folder:
        stream = Path(folder) / "stream"
        start = time.perf_counter()
        train_stream(training(config, setting, stream), Console(quiet=True))
        seconds = time.perf_counter() - start
        scores = evaluate_stream(EvaluateConfig(stream, config.capture)).layers
        reader = StreamReader(stream)
        return Outcome(
            scores[-1].psnr_db,
            scores[-1].moving_psnr_db,
            scores[-1].ssim,
            scores[-1].flicker,
            slice_bytes(reader),
            [score.psnr_db for score in scores],
            [score.bytes_per_frame for score in scores],
            seconds,
            examine(reader),
        )


def kept_path(config: TrialsConfig, setting: Setting) -> Path:
    """Path of the kept outcome of this run; each capture and setting has a name of its own."""
    told = asdict(training(config, setting, Path("stream")))
    told["outcome"] = [f.name for f in fields(Outcome)]
    digest = hashlib.sha256(json.dumps(told, sort_keys=True, default=str).encode())
    return config.work / f"{digest.hexdigest()[:16]}.json"


def keep(path: Path, outcome: Outcome) -> None:
    write_atomic(path, json.dumps(asdict(outcome), indent=1).encode())


def relative_cost(fit: FitConfig, num_frames: int) -> float:
    """Relative time of a run: a step has a fixed part and a part that grows with num_gs."""
    steps = fit.iterations(0) + (num_frames - 1) * fit.iterations(1)
    return steps * (1 + fit.num_gs / 8_000)


def runs(config: TrialsConfig, chosen: Sequence[Setting]) -> Iterator[tuple[Setting, Setting]]:
    """Pairs of a setting and the same setting with a seed. They go seed by seed, so that all
    settings have nearly the same number of runs after an early stop."""
    for seed in range(config.seeds):
        for setting in chosen:
            yield setting, replace(setting, fit=replace(setting.fit, seed=seed))


def measure(
    config: TrialsConfig, chosen: Sequence[Setting], examine: Examine = nothing_more
) -> Outcomes:
    """Runs every setting with every seed; prints a line on standard error for each run."""
    log = Console(stderr=True)
    config.work.mkdir(parents=True, exist_ok=True)
    num_frames = len(
        FrameRange.parse(config.frames).of(open_capture(config.capture).num_frames, config.capture)
    )
    all_runs = list(runs(config, chosen))
    outcomes: dict[Setting, list[Outcome]] = {setting: [] for setting in chosen}
    left = sum(
        relative_cost(seeded.fit, num_frames)
        for _, seeded in all_runs
        if not kept_path(config, seeded).is_file()
    )
    done = spent_s = 0.0
    for number, (setting, seeded) in enumerate(all_runs, start=1):
        path = kept_path(config, seeded)
        was_kept = path.is_file()
        if was_kept:
            outcome = Outcome(**json.loads(path.read_text()))
        else:
            start = time.perf_counter()
            outcome = measure_once(config, seeded, examine)
            keep(path, outcome)
            spent_s += time.perf_counter() - start
            done += relative_cost(seeded.fit, num_frames)
            left -= relative_cost(seeded.fit, num_frames)
        outcomes[setting].append(outcome)
        text = "kept from before" if was_kept else f"{outcome.seconds:.0f} s"
        if done:
            text += f"; about {spent_s / done * left / 60:.0f} min left"
        log.print(
            f"{number}/{len(all_runs)} {setting.name}, seed {seeded.fit.seed}: "
            f"{outcome.psnr_db:.2f} dB, {text}",
            highlight=False,
        )
    return outcomes


def mean(values: Sequence[float]) -> float:
    return float(np.mean(values))


def spread(values: Sequence[float], form: str) -> str:
    """The mean, and half the difference between the largest and the smallest value."""
    text = format(mean(values), form)
    return f"{text} ±{(max(values) - min(values)) / 2:.2f}" if len(values) > 1 else text


def table_of(outcomes: Outcomes) -> Table:
    """Means over the seeds. Differences are to the first setting of the same comparison, taken seed
    by seed, because a seed shifts all settings alike."""
    table = Table(box=box.MARKDOWN)
    table.add_column("setting")
    for name in ("PSNR dB", "dB to the first", "SSIM", "flicker", "kB/frame", "seconds"):
        table.add_column(name, justify="right")
    firsts: dict[str, Sequence[Outcome]] = {}
    for setting, found in outcomes.items():
        first = firsts.setdefault(setting.group, found)
        psnr_db = [o.psnr_db for o in found]
        gains_db = [o.psnr_db - f.psnr_db for o, f in zip(found, first, strict=True)]
        flicker = [o.flicker for o in found if o.flicker is not None]
        table.add_row(
            setting.name,
            spread(psnr_db, ".2f"),
            "-" if found is first else spread(gains_db, "+.2f"),
            f"{mean([o.ssim for o in found]):.4f}",
            f"{mean(flicker):.3f}" if flicker else "-",
            f"{mean([o.bytes_per_frame for o in found]) / 1e3:.1f}",
            f"{mean([o.seconds for o in found]):.0f}",
        )
    return table


def draw_points(
    axes: matplotlib.axes.Axes, x: Sequence[float], found: Sequence[Sequence[Outcome]], colour: str,
    label: str | None,
) -> None:  # fmt: skip
    """Draws the means at `x`, joined, and a small dash for each seed."""
    axes.plot(
        x, [mean([o.psnr_db for o in f]) for f in found], "-o", color=colour, markersize=6,
        label=label,
    )  # fmt: skip
    for at, of_seeds in zip(x, found, strict=True):
        axes.plot(
            [at] * len(of_seeds), [o.psnr_db for o in of_seeds], "_", color=colour, markersize=12
        )


def draw(outcomes: Outcomes, config: AblateConfig) -> None:
    figure = matplotlib.figure.Figure(figsize=(10, 4.8), layout="constrained")
    matplotlib.backends.backend_agg.FigureCanvasAgg(figure)
    ages, sizes = figure.subplots(1, 2)
    for shift, carried in enumerate(CARRIED):
        found = [o for s, o in outcomes.items() if s.group == AGE and s.carried == carried]
        x = [i + 0.08 * (2 * shift - 1) for i in range(len(found))]
        draw_points(ages, x, found, COLOURS[carried], f"Adam's history {CARRIED[carried]}")
    ages.set_xticks(range(len(AGE_SCALINGS)), AGE_SCALINGS)
    ages.set_xlim(-0.5, len(AGE_SCALINGS) - 0.5)
    ages.set_xlabel("age scaling of positions: factor of 1 / (1 + age)")
    ages.set_title(
        f"{config.age_num_gs:,} Gaussians, swin_size {config.age_swin_size}", fontsize=10
    )
    ages.legend(fontsize=9)
    by_size = {s: o for s, o in outcomes.items() if s.group == SIZE}
    places = list(range(len(by_size)))
    draw_points(sizes, places, list(by_size.values()), "#2b8a3e", None)
    for at, of_seeds in zip(places, by_size.values(), strict=True):
        sizes.annotate(
            f"{mean([o.bytes_per_frame for o in of_seeds]) / 1e3:.0f} kB/frame",
            (at, min(o.psnr_db for o in of_seeds)), xytext=(0, -16),
            textcoords="offset points", ha="center", fontsize=8,
        )  # fmt: skip
    sizes.set_xticks(places, [f"{s.fit.num_gs:,}:{s.fit.swin_size}" for s in by_size])
    sizes.set_xlim(-0.5, len(by_size) - 0.5)
    sizes.set_xlabel("num_gs:swin_size")
    sizes.set_title(f"equal bandwidth: {config.slice_size:,} Gaussians sent per frame", fontsize=10)
    for axes in (ages, sizes):
        axes.set_ylabel("PSNR, dB, held-out cameras")
        axes.margins(y=0.2)
        axes.grid(alpha=0.3)
    seeds = f", bars: {config.seeds} seeds" if config.seeds > 1 else ""
    figure.suptitle(
        f"{config.capture.resolve().name} at {config.scale:g}, frames {config.frames}, "
        f"{config.genesis_iterations:,} + {config.window_iterations:,} iterations{seeds}",
        fontsize=11,
    )
    config.out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(config.out, dpi=120, metadata={"Software": None})


def run(config: AblateConfig) -> None:
    if config.seeds < 1 or not config.swin_sizes:
        raise InvalidError("give at least one seed and one of swin_sizes")
    outcomes = measure(config, settings(config))
    Console(width=130).print(table_of(outcomes))
    draw(outcomes, config)


if __name__ == "__main__":
    run_command(AblateConfig, run, "scripts/bench ablate", "Compares the choices of the paper.")
