"""Figures of held plays, from the records of `playload`. No clock, no sockets.

Definitions of the figures:

* head: time from the write of a client's request to the first byte of the response. The connection
  exists by then, so the wait until the server accepts it counts.
* record: time from the same write to the end of the first record. picture: time to the last packet
  of layer 0 that the first requested frame needs: a keyframe, and the slices from there to that
  frame. A keyframe counts as the slice of its frame.
* due: a player that shows its first picture at that moment and 30 frames per second from then on
  needs layer 0 of the slice born at f when it shows frame f. late: delay of the slice after that
  time, 0 if it arrived before; a slice that was due and had not arrived at the end counts as
  arrived at the end. A server sends ahead, so this is 0 until its whole lead is used up.
* gap: time between two reads that bring layer 0 of a new slice, counted once all clients have
  arrived and settled. Until then, a server fills their leads as fast as it can, and `late` shows
  whether that is fast enough. The server rests on purpose between bursts. beyond: a gap minus that
  rest. The rest of a client is the median of its gaps longer than half of rest_s, because the
  server lengthens its rests at random. It is at most max_rest_s plus one frame, the limit of the
  server's own rules, so that a server that is always late shows; and at least one frame. Rests end
  with a whole frame, so gaps of an otherwise idle server differ by up to one frame.
* layers: number of layers of a slice that had arrived by the end, for slices that were due by then.
* missing: births between a client's first and last for which layer 0 never arrived.
  double: repeated packets of the same slice and layer.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Doubles = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Spread:
    """Median, 99th percentile and maximum of some values; NaN if there are none."""

    p50: float
    p99: float
    max: float

    @classmethod
    def of(cls, values: Doubles) -> Spread:
        values = values[~np.isnan(values)]
        if not len(values):
            return cls(np.nan, np.nan, np.nan)
        return cls(*(float(np.quantile(values, share)) for share in (0.5, 0.99, 1.0)))


@dataclass(frozen=True, slots=True)
class PlayFigures:
    """Figures of all clients together; times in ms."""

    clients: int
    failed: int
    """Clients that were refused, were cut off, or never had a picture."""
    head_ms: Spread
    record_ms: Spread
    picture_ms: Spread
    late_ms: Spread
    """Over all slices of all clients."""
    beyond_ms: Spread
    """Over all gaps of all clients."""
    rest_ms: Spread
    """Over all clients: the measured rest."""
    layers: float
    """Mean over all slices."""
    missing: int
    double: int
    server_share: float
    """The server's share of a core, once all clients had arrived and settled."""
    load_share: float
    """The same share of the clients' process; near 1 the figures describe the clients."""
    load_longest_ms: float
    others_share: float
    """Cores used by all other processes; above 0.1 the measurement is not valid."""
    server_rss_bytes: int
    bytes_per_s: float
    """Rate of packet bytes, with frame_bytes for a slice with all its layers."""


@dataclass(frozen=True, slots=True)
class Seen:
    """The records that `playload` wrote."""

    arrays: dict[str, NDArray[Any]]
    known: dict[str, float]

    @classmethod
    def read(cls, path: Path) -> Seen:
        with np.load(path) as file:
            arrays = {name: file[name] for name in file.files}
        return cls(arrays, json.loads(str(arrays.pop("known"))))


@dataclass(frozen=True, slots=True)
class Shape:
    """Parameters of the stream and of the server's pacing."""

    fps: float
    num_layers: int
    rest_s: float
    """The server's rest_s: minimum rest between two bursts."""
    max_rest_s: float
    """Maximum rest after the server has lengthened it."""
    from_frame: int = 0


def first_arrivals(births: NDArray[np.int32], at_s: Doubles) -> tuple[NDArray[np.int32], Doubles]:
    """The distinct births, sorted, and the time at which each first arrived."""
    ordered = np.lexsort((at_s, births))
    found, first = np.unique(births[ordered], return_index=True)
    return found, at_s[ordered][first]


def late_of(births: NDArray[np.int32], came_s: Doubles, shape: Shape, ended_s: float) -> Doubles:
    """Delay in seconds of each slice due by `ended_s`; empty if the client had no picture."""
    picture_s = picture_at(births, came_s, shape)
    if np.isnan(picture_s):
        return np.empty(0)
    num_due = int((ended_s - picture_s) * shape.fps)
    wanted = np.arange(shape.from_frame + 1, shape.from_frame + 1 + num_due)
    when = dict(zip(births.tolist(), came_s.tolist(), strict=True))
    arrived_s = np.array([when.get(birth, ended_s) for birth in wanted.tolist()])
    due_s = picture_s + (wanted - shape.from_frame) / shape.fps
    return np.asarray(np.maximum(0.0, arrived_s - due_s))


def picture_at(births: NDArray[np.int32], came_s: Doubles, shape: Shape) -> float:
    """Time at which the first picture could show; NaN if never."""
    of_it = births <= shape.from_frame
    needed = shape.from_frame - births[0] + 1 if of_it.any() else 1
    return float(came_s[of_it].max()) if of_it.sum() == needed else np.nan


def beyond_of(
    came_s: Doubles, shape: Shape, steady_s: float, ended_s: float
) -> tuple[Doubles, float]:
    """Seconds by which each gap from `steady_s` on exceeds the rest; and the rest."""
    times_s = np.unique(came_s[came_s >= steady_s])
    gaps_s = np.diff(times_s)
    long = gaps_s[gaps_s > shape.rest_s / 2]
    # The time since the last read is a gap, too, in case the play stopped.
    gaps_s = np.append(gaps_s, ended_s - (times_s[-1] if len(times_s) else steady_s))
    frame_s = 1 / shape.fps
    rest_s = float(np.median(long)) if len(long) else frame_s
    rest_s = max(frame_s, min(rest_s, shape.max_rest_s + frame_s))
    return np.maximum(0.0, gaps_s - rest_s), rest_s


def figures_of(seen: Seen, shape: Shape, frame_bytes: int = 0) -> PlayFigures:
    """The figures of everything that `playload` recorded."""
    arrays, known = seen.arrays, seen.known
    num_clients = len(arrays["asked_s"])
    late, beyond, rests, pictures = [], [], [], []
    missing = double = packets = 0
    layers = []
    failed = 0
    order = np.argsort(arrays["who"], kind="stable")
    bounds = np.searchsorted(arrays["who"][order], np.arange(num_clients + 1))
    for number in range(num_clients):
        mine = order[bounds[number] : bounds[number + 1]]
        births, at_s = arrays["birth"][mine], arrays["at_s"][mine]
        first, count = arrays["first"][mine].astype(int), arrays["layers"][mine].astype(int)
        base = first == 0
        found, came_s = first_arrivals(births[base], at_s[base])
        picture_s = picture_at(found, came_s, shape)
        pictures.append(picture_s - arrays["asked_s"][number])
        if np.isnan(picture_s) or arrays["over"][number] or arrays["status"][number] != 200:
            failed += 1
        missing += int(found[-1] - found[0] + 1 - len(found)) if len(found) else 0
        pairs = [
            (birth, layer)
            for birth, start, n in zip(births.tolist(), first, count, strict=True)
            for layer in range(start, start + n)
        ]
        double += len(pairs) - len(set(pairs))
        late.append(late_of(found, came_s, shape, known["ended_s"]))
        last_due = shape.from_frame + (known["ended_s"] - picture_s) * shape.fps
        layers += [n for birth, n in layers_of(births, count).items() if birth <= last_due]
        if not np.isnan(picture_s):
            since_s = max(picture_s, known["steady_s"])
            more, rest_s = beyond_of(came_s, shape, since_s, known["ended_s"])
            beyond.append(more)
            rests.append(rest_s)
        packets += len(pairs)
    lasted_s = known["ended_s"] - known["began_s"]
    return PlayFigures(
        clients=num_clients,
        failed=failed,
        head_ms=Spread.of(1000 * (arrays["head_s"] - arrays["asked_s"])),
        record_ms=Spread.of(1000 * (arrays["record_s"] - arrays["asked_s"])),
        picture_ms=Spread.of(1000 * np.array(pictures)),
        late_ms=Spread.of(1000 * np.concatenate(late)),
        beyond_ms=Spread.of(1000 * np.concatenate(beyond) if beyond else np.empty(0)),
        rest_ms=Spread.of(1000 * np.array(rests)),
        layers=float(np.mean(layers)) if layers else np.nan,
        missing=missing,
        double=double,
        server_share=known["server_share"],
        load_share=known["load_share"],
        load_longest_ms=1000 * known["load_longest_s"],
        others_share=known["others_share"],
        server_rss_bytes=int(known["server_rss_bytes"]),
        bytes_per_s=packets * frame_bytes / shape.num_layers / lasted_s,
    )


def layers_of(births: NDArray[np.int32], count: NDArray[np.int_]) -> dict[int, int]:
    """Number of layers that arrived of each slice, by birth."""
    found: dict[int, int] = {}
    for birth, n in zip(births.tolist(), count.tolist(), strict=True):
        found[birth] = found.get(birth, 0) + n
    return found


def live_latency_s(
    seen: Seen, born_s: dict[int, tuple[int, float]], after_s: float
) -> tuple[Doubles, Doubles]:
    """Seconds from a segment's birth on disk until each client had its first and its last slice.

    born_s: for each segment, by its first birth: one past its last birth, and the wall-clock time
    of its index record. Segments born before `after_s` do not count, nor segments that had not
    arrived completely at the end. File times come from a clock with steps of a few ms, and are
    late.
    """
    arrays = seen.arrays
    at_s = arrays["at_s"] + seen.known["realtime_offset_s"]
    base = arrays["first"] == 0
    firsts, lasts = [], []
    for number in range(len(arrays["asked_s"])):
        mine = base & (arrays["who"] == number)
        found, came_s = first_arrivals(arrays["birth"][mine], at_s[mine])
        when = dict(zip(found.tolist(), came_s.tolist(), strict=True))
        for birth, (end_birth, on_disk_s) in born_s.items():
            if on_disk_s < after_s or end_birth - 1 not in when or birth not in when:
                continue
            firsts.append(when[birth] - on_disk_s)
            lasts.append(when[end_birth - 1] - on_disk_s)
    return np.array(firsts), np.array(lasts)
