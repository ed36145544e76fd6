"""The loss of quality by each quantised attribute: the paper's Table 6 on a stream of ours.

Usage: scripts/bench quantisation RAW CAPTURE [--every N] [--json]

RAW is the folder that swings-train wrote with --raw-stream: every float of the Gaussians.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from bench.papercoding import ATTRIBUTES, quantise_attribute
from codec.console import run_command, say
from codec.errors import InvalidError
from codec.progressline import counted
from codec.slots.state import ON_LATTICE
from codec.splats import Splats, sh_count
from trainer.score.truth import Score, open_held_out, score_splats


@dataclass(frozen=True)
class QuantisationConfig:
    """Scores a raw stream with one attribute at a time quantised as in the paper's Table 6."""

    stream: tyro.conf.Positional[Path]
    """Folder of the raw stream."""
    capture: tyro.conf.Positional[Path]
    """Folder of the capture that it was trained from."""
    every: int = 1
    """Step between scored frames."""
    json: bool = False
    """Print JSON instead of a table."""


FULL_BYTES = 4
"""Size of a float32, which every attribute of a raw stream is made of."""

FORMATS = {
    "means": ("fp16", 2),
    "rotation": ("uint8", 1),
    "scale": ("fp16", 2),
    "feat": ("fp16", 2),
    "opacity": ("uint8", 1),
}
"""The type of each number of an attribute, and its bytes."""

CASES: dict[str, tuple[str, ...]] = {
    "none": (),
    **{attribute: (attribute,) for attribute in ATTRIBUTES},
    "all but feat": tuple(attribute for attribute in ATTRIBUTES if attribute != "feat"),
    "all": tuple(ATTRIBUTES),
}
"""The attributes quantised in each row of the table. The paper streams "all but feat"."""


def _numbers(sh_degree: int) -> dict[str, int]:
    """Numbers in each attribute of a Gaussian."""
    return {"means": 3, "rotation": 4, "scale": 3, "feat": 3 * sh_count(sh_degree), "opacity": 1}


@dataclass(frozen=True, slots=True)
class AblationRow:
    """The stream with some attributes quantised; means over held-out cameras and frames."""

    case: str
    """A key of CASES."""
    format: str
    """fp16 or uint8, or nothing where attributes differ."""
    raw_bytes: int
    """Bytes of these attributes (of all, for "none") in a raw Gaussian, before the entropy
    coder."""
    bytes: int
    """The same after quantisation."""
    psnr_db: float
    ssim: float
    difference_db: float
    """PSNR against "none"."""


@dataclass(frozen=True, slots=True)
class Ablation:
    """A row for each of CASES, in their order."""

    stream: str
    capture: str
    frames: int
    """Frames scored."""
    cameras: list[str]
    rows: list[AblationRow]

    def to_json(self) -> dict[str, Any]:
        return asdict(self)

    def table(self) -> Table:
        """For people, as Table 6 stands in the paper but upright."""
        table = Table(
            title=f"{self.stream}: {self.frames} frames, held out: {', '.join(self.cameras)}",
            caption="bytes a Gaussian, before the entropy coder",
        )
        table.add_column("quantised")
        table.add_column("to")
        for name in ("bytes raw", "bytes", "PSNR dB", "SSIM", "dB to none"):
            table.add_column(name, justify="right")
        for row in self.rows:
            table.add_row(
                row.case,
                row.format,
                str(row.raw_bytes),
                str(row.bytes),
                f"{row.psnr_db:.3f}",
                f"{row.ssim:.4f}",
                f"{row.difference_db:+.3f}",
            )
        return table


def _sizes(case: str, sh_degree: int) -> tuple[int, int]:
    """Bytes of the attributes of `case` in a Gaussian: raw, and quantised."""
    numbers = _numbers(sh_degree)
    if not CASES[case]:
        whole = FULL_BYTES * sum(numbers.values())
        return whole, whole
    chosen = {attribute: numbers[attribute] for attribute in CASES[case]}
    return FULL_BYTES * sum(chosen.values()), sum(FORMATS[a][1] * n for a, n in chosen.items())


def quantise_case(splats: Splats, case: str) -> Splats:
    """`splats` with the attributes of `case`, a key of CASES, as the paper's quantisation leaves
    them. Raises InvalidError for a value that fp16 cannot hold."""
    return reduce(quantise_attribute, CASES[case], splats)


def ablate_quantisation(
    config: QuantisationConfig, on_progress: Callable[[int, int], None] = lambda done, total: None
) -> Ablation:
    """Renders every frame, with all layers, for each of CASES. on_progress(pictures done, in all).

    Raises InvalidError for a stream that is quantised already, and what `evaluate_stream` raises.
    """
    scores: dict[str, list[Score]] = {case: [] for case in CASES}
    with open_held_out(config.stream, config.capture) as held_out:
        reader, manifest = held_out.reader, held_out.reader.manifest
        lanes = reader.decoder_at(0, manifest.num_layers).lanes
        if any((slots.conditions == ON_LATTICE).any() for lane in lanes for slots in lane):
            raise InvalidError(
                f"{config.stream} is quantised already; name the folder that swings-train wrote "
                "with --raw-stream"
            )
        chosen = held_out.every(config.every)
        done, total = 0, len(chosen) * len(CASES) * len(held_out.cameras)
        for frame in chosen:
            shots = held_out.shots(frame)
            exact = reader.active_splats(frame, manifest.num_layers)
            for case, found in scores.items():
                splats = quantise_case(exact, case)
                for camera, shot in zip(held_out.cameras, shots, strict=True):
                    near_m = manifest.near_of(camera)
                    found.append(score_splats(splats, camera, shot, near_m))
                    done += 1
                    on_progress(done, total)
    psnr = {case: float(np.mean([s.psnr_db for s in found])) for case, found in scores.items()}
    rows = [
        AblationRow(
            case,
            FORMATS[case][0] if case in FORMATS else "",
            *_sizes(case, manifest.sh_degree),
            psnr_db=psnr[case],
            ssim=float(np.mean([s.ssim for s in found])),
            difference_db=psnr[case] - psnr["none"],
        )
        for case, found in scores.items()
    ]
    return Ablation(
        stream=str(config.stream),
        capture=str(config.capture),
        frames=len(chosen),
        cameras=[camera.name for camera in held_out.cameras],
        rows=rows,
    )


def run(config: QuantisationConfig) -> None:
    with counted("scoring") as note:
        found = ablate_quantisation(config, note)
    if config.json:
        say(json.dumps(found.to_json(), indent=1))
    else:
        Console().print(found.table())


if __name__ == "__main__":
    run_command(
        QuantisationConfig, run, "scripts/bench quantisation", "The loss by quantised attributes."
    )
