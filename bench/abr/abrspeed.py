"""Speed of simulated plays, in multiples of real time, by policy.

Usage: scripts/bench abrspeed [--length-s 60] [--repeats 3]

The speed is from the CPU time of one process. `play` is the session, the policy and the link;
`scored` also shows the frames; the oracle's bound is measured apart.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from rich.console import Console
from rich.table import Table

from bench.abr.oracle import judge
from codec.console import run_command
from server.abr.media import SegmentSizes
from server.study.choice import POLICIES, make_policy
from server.study.config import Rules
from server.study.generate import GeneratorConfig, generate
from server.study.looped import LoopedMedia
from server.study.simulator import simulate
from server.study.study import Case, at_load, score_play
from server.study.tracefolder import Trace

FPS = 30.0
SIZES = SegmentSizes(
    (17.7e3, 4.3e3, 5.1e3, 7.0e3),
    (27.82, 28.78, 29.25, 29.69),
    (150e3, 75e3, 85e3, 120e3),
    (0.3, 0.15, 0.15, 0.15),
)
"""Sizes of the basketball stream of docs/RESULTS.md."""


@dataclass(frozen=True, slots=True)
class AbrSpeedConfig:
    """Simulated plays."""

    length_s: float = 60.0
    """Seconds of each play."""
    repeats: int = 3
    """Number of repeats; the shortest time counts."""
    load: float = 1.0
    """Ratio of the link's rate to the rate of the stream with all layers."""


def least_s(config: AbrSpeedConfig, run: Callable[[], object]) -> float:
    """The shortest CPU time of `run` over the repeats."""
    times_s = []
    for _ in range(config.repeats):
        began_s = time.process_time()
        run()
        times_s.append(time.process_time() - began_s)
    return min(times_s)


def play_only(media: LoopedMedia, case: Case, policy: str, rules: Rules) -> None:
    simulate(media, make_policy(policy), case.link, rules.session)


def run(config: AbrSpeedConfig) -> None:
    table = Table("policy", "play", "scored", title="times faster than real time")
    for column in table.columns[1:]:
        column.justify = "right"
    media, rules = LoopedMedia((SIZES,), round(FPS * config.length_s), FPS, 30), Rules()
    link = generate(GeneratorConfig(outages_per_minute=1.0), seed=1)
    case = at_load(Trace("made up", link), config.load, media)
    for policy in POLICIES:
        plays = (
            partial(play_only, media, case, policy, rules),
            partial(score_play, media, case, policy, rules),
        )
        times = (f"{config.length_s / least_s(config, play):.0f}" for play in plays)
        table.add_row(policy, *times)
    bound_s = least_s(config, partial(judge, media, case, rules))
    table.add_row("oracle", "", f"{config.length_s / bound_s:.0f}")
    Console().print(table)


def main() -> None:
    run_command(
        AbrSpeedConfig, run, "scripts/bench abrspeed", "Measures the speed of simulated plays."
    )


if __name__ == "__main__":
    main()
