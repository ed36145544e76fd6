"""Made-up situations for rules."""

from __future__ import annotations

from dataclasses import replace
from itertools import accumulate

from hypothesis import strategies as st

from server.study.policies.situation import Group, Situation

MAX_LEAD_S = 6.0


def group(
    layer_bytes: tuple[float, ...] = (10e3, 5e3, 5e3),
    gains_db: tuple[float, ...] = (25.0, 2.0, 1.0),
    snapshot_bytes: tuple[float, ...] = (),
    can_rise: bool = True,
    media_s: float = 0.5,
) -> Group:
    return Group(
        media_s,
        tuple(accumulate(layer_bytes)),
        tuple(accumulate(gains_db)),
        tuple(accumulate(snapshot_bytes)) or (0.0,) * len(layer_bytes),
        can_rise,
    )


def situation(
    coming: tuple[Group, ...] = (group(),),
    rate_bps: float = 1e6,
    lead_s: float = 3.0,
    held: int = 1,
    now_s: float = 0.0,
    measured: bool = True,
) -> Situation:
    return Situation(now_s, rate_bps, measured, lead_s, MAX_LEAD_S, held, coming)


def later(before: Situation, passed_s: float, rate_bps: float) -> Situation:
    return replace(before, now_s=before.now_s + passed_s, rate_bps=rate_bps)


@st.composite
def groups(draw: st.DrawFn, num_layers: int) -> Group:
    sizes = tuple(draw(st.floats(1e3, 1e5)) for _ in range(num_layers))
    gains = (25.0, *(draw(st.floats(0.0, 4.0)) for _ in range(num_layers - 1)))
    snapshots = tuple(draw(st.floats(1e3, 3e5)) for _ in range(num_layers))
    return group(sizes, gains, snapshots, draw(st.booleans()))


@st.composite
def situations(draw: st.DrawFn, horizon: int = 1, most_layers: int = 5) -> Situation:
    """Any situation of a client that plays."""
    layers = draw(st.integers(1, most_layers))
    return situation(
        tuple(draw(groups(layers)) for _ in range(draw(st.integers(1, horizon)))),
        draw(st.floats(1e5, 1e8)),
        draw(st.floats(0, MAX_LEAD_S)),
        draw(st.integers(1, layers)),
    )
