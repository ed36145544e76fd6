"""What held plays were like, from what `playload` wrote down. No clock, no sockets.

The words of its figures, exactly:

* head: from when a client's request was written to the first byte of the response. The connection
  stood already, so waiting to be accepted counts.
* record: the same to the end of the first record. picture: to the last packet of layer 0 that the
  first frame asked for needs: a snapshot, and the slices from there to that frame. A snapshot
  counts as the slice of its frame.
* due: a player that began to show at that moment, its first picture, and showed 30 frames a second
  since, needs layer 0 of the slice born at f by the time that it shows frame f. late: how long
  after that it came, 0 if before; a slice that was due and had not come at the end counts as
  arrived then. A server sends ahead, so this is 0 until its whole lead has been used up.
* gap: the time between two reads that bring layer 0 of a new slice, counted once all clients have
  arrived and settled; while they do, a server fills their leads as it can, and `late` tells whether
  that is enough. The server rests on purpose between bursts. beyond: a gap less that rest. The rest
  of a client is the median of its gaps longer than half of rest_s, as the server makes it longer
  than that by chance; it is never taken for more than max_rest_s and a frame, which is what the
  server's own rules allow, so that one that is always late cannot hide, nor for less than a frame.
  As rests end with a whole frame, gaps of a server that has nothing else to do differ by a frame.
* layers: how many layers of a slice had come by the end, of slices that were due by then.
* missing: births between the first and the last that a client got of which layer 0 never came.
  double: packets of the same slice and layer that came again.
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
    """Of some values: in the middle, almost at the end, at the end. NaN where there are none."""

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
    """All clients together; times in ms."""

    clients: int
    failed: int
    """Clients that were refused, cut off, or never shown a picture."""
    head_ms: Spread
    record_ms: Spread
    picture_ms: Spread
    late_ms: Spread
    """Over all slices of all clients."""
    beyond_ms: Spread
    """Over all gaps of all clients."""
    rest_ms: Spread
    """Over all clients: the rest that was found."""
    layers: float
    """Mean over all slices."""
    missing: int
    double: int
    server_share: float
    """Of a core, once all had arrived."""
    load_share: float
    """The same of the clients' process: 1 would be a measurement of itself."""
    load_longest_ms: float
    others_share: float
    """What everything else on the machine took, in cores: above a tenth it is not a measurement."""
    server_rss_bytes: int
    bytes_per_s: float
    """Of packets, at frame_bytes for a slice with all its layers."""


@dataclass(frozen=True, slots=True)
class Seen:
    """What `playload` wrote."""

    arrays: dict[str, NDArray[Any]]
    known: dict[str, float]

    @classmethod
    def read(cls, path: Path) -> Seen:
        with np.load(path) as file:
            arrays = {name: file[name] for name in file.files}
        return cls(arrays, json.loads(str(arrays.pop("known"))))


@dataclass(frozen=True, slots=True)
class Shape:
    """What must be known of the stream and of the server's pacing."""

    fps: float
    num_layers: int
    rest_s: float
    """What the server calls so: the least rest between two bursts."""
    max_rest_s: float
    """The longest that it makes of that."""
    from_frame: int = 0


def first_arrivals(births: NDArray[np.int32], at_s: Doubles) -> tuple[NDArray[np.int32], Doubles]:
    """The births, each once, in order, and when each came first."""
    ordered = np.lexsort((at_s, births))
    found, first = np.unique(births[ordered], return_index=True)
    return found, at_s[ordered][first]


def late_of(births: NDArray[np.int32], came_s: Doubles, shape: Shape, ended_s: float) -> Doubles:
    """Seconds, for each slice due by `ended_s`; nothing of a client that had no picture."""
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
    """When the first picture could show; NaN if never."""
    of_it = births <= shape.from_frame
    needed = shape.from_frame - births[0] + 1 if of_it.any() else 1
    return float(came_s[of_it].max()) if of_it.sum() == needed else np.nan


def beyond_of(
    came_s: Doubles, shape: Shape, steady_s: float, ended_s: float
) -> tuple[Doubles, float]:
    """Seconds by which each gap from `steady_s` on is longer than the rest; the rest."""
    times_s = np.unique(came_s[came_s >= steady_s])
    gaps_s = np.diff(times_s)
    long = gaps_s[gaps_s > shape.rest_s / 2]
    # A play that stopped is a gap as well.
    gaps_s = np.append(gaps_s, ended_s - (times_s[-1] if len(times_s) else steady_s))
    frame_s = 1 / shape.fps
    rest_s = float(np.median(long)) if len(long) else frame_s
    rest_s = max(frame_s, min(rest_s, shape.max_rest_s + frame_s))
    return np.maximum(0.0, gaps_s - rest_s), rest_s


def figures_of(seen: Seen, shape: Shape, frame_bytes: int = 0) -> PlayFigures:
    """Of everything that was seen."""
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
    """How many layers came of each slice."""
    found: dict[int, int] = {}
    for birth, n in zip(births.tolist(), count.tolist(), strict=True):
        found[birth] = found.get(birth, 0) + n
    return found


def live_latency_s(
    seen: Seen, born_s: dict[int, tuple[int, float]], after_s: float
) -> tuple[Doubles, Doubles]:
    """Seconds from a segment's birth on disk until each client had its first and its last slice.

    born_s: of each segment, by its first birth, one past its last, and when it was there, by the
    clock of the day. Segments born before `after_s` do not count, nor those that had not come
    whole when it ended. The clock that stamps files is a few ms coarse, and behind.
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
