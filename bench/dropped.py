"""A stream without the Gaussians that rank lowest, as a stream of its own.

Of every slice the same share is kept. A Gaussian's rank holds for its life, so that it does not
come and go: a life goes on until its slot is ended or new, and what a Gaussian is
worth is the mean over the slices that it is in.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bench.recordedupdates import recorded_slices, recorded_update
from codec.arrays import Bytes, Doubles, Flags, Longs
from codec.slice import active_splats
from codec.slots.slotlayout import ENDED, KEPT, NEW
from codec.stream import StreamReader, StreamWriter
from trainer.step.contribution import summed_contribution
from trainer.step.raster import Parameters, View

NOBODY = -1
"""In place of a life where a slot is empty."""


def lives_of(reader: StreamReader) -> dict[int, Longs]:
    """By birth (N,): the number of the life of each Gaussian of the whole slice; NOBODY in an empty
    slot."""
    manifest, lives, count = reader.manifest, dict[int, Longs](), 0
    nobody = np.full(manifest.slice_size, NOBODY, np.int64)
    for birth, _, statuses in recorded_slices(reader):
        of_lane = lives.get(birth - manifest.swin_size, nobody).copy()
        of_lane[statuses == ENDED] = NOBODY
        new = np.flatnonzero(statuses == NEW)
        of_lane[new] = np.arange(count, count + len(new))
        count += len(new)
        lives[birth] = of_lane
    return lives


def slices_lived(lives: Mapping[int, Longs]) -> Longs:
    """(L,) in how many slices each life is."""
    everyone = np.concatenate([of_slice[of_slice != NOBODY] for of_slice in lives.values()])
    return np.bincount(everyone)


def opacities(reader: StreamReader, lives: Mapping[int, Longs]) -> Doubles:
    """(L,) the opacity of each life, the mean over its slices."""
    counts = slices_lived(lives)
    sums = np.zeros(len(counts))
    for birth, of_slice in lives.items():
        logits = reader.slice(birth, reader.manifest.num_layers).splats.logit_opacities
        here = of_slice != NOBODY
        sums[of_slice[here]] += 1 / (1 + np.exp(-logits[here].astype(np.float64)))
    mean: Doubles = sums / counts
    return mean


def contributions(
    reader: StreamReader, lives: Mapping[int, Longs], views: Sequence[View], each: int
) -> Doubles:
    """(L,) what each life contributes to pictures of `views`, `each` of them for every frame in
    turn: the sum over the frames in which it shows, over its slices."""
    manifest, counts = reader.manifest, slices_lived(lives)
    sums = np.zeros(len(counts))
    for frame in range(reader.num_frames):
        window = reader.window(frame, manifest.num_layers)
        splats = active_splats(window, frame, manifest.swin_size)
        shown = [lives[part.birth][part.active(frame, manifest.swin_size)] for part in window]
        turn = [views[(frame + n * len(views) // each) % len(views)] for n in range(each)]
        rows = np.arange(len(splats), dtype=np.int32)
        values = Parameters(*splats.arrays)
        sums[np.concatenate(shown)] += summed_contribution(values, rows, turn, [None] * each)
    mean: Doubles = sums / counts
    return mean


def places(importances: Doubles) -> Longs:
    """(L,) the place of each life, the most important first; equal ones are drawn, so that the
    order in the files, which the trainer chose, does not help."""
    drawn = np.random.default_rng(0).permutation(len(importances))
    found = np.empty(len(importances), np.int64)
    found[np.lexsort((drawn, -importances))] = np.arange(len(importances))
    return found


@dataclass(frozen=True, slots=True)
class Drop:
    """Which Gaussians are kept."""

    share: float
    """The share of a slice's Gaussians that is kept."""
    places: Longs = field(repr=False)
    """(L,) of each life, see `places`."""

    def kept(self, of_slice: Longs) -> Flags:
        """(N,) which Gaussians of a slice are kept, given its lives."""
        held = np.flatnonzero(of_slice != NOBODY)
        most_first = held[np.argsort(self.places[of_slice[held]])]
        kept = np.zeros(len(of_slice), np.bool_)
        kept[most_first[: round(self.share * len(held))]] = True
        return kept


def statuses_of_kept(statuses: Bytes, before: Flags, kept: Flags) -> Bytes:
    """(S,) what a slice of `statuses` says if of the slots in its lane `before` were sent until
    now, and from now on `kept` are."""
    cases = kept & ~before, before & ~kept, kept
    return np.select(cases, (np.uint8(NEW), np.uint8(ENDED), statuses), np.uint8(KEPT))


def write_kept(
    reader: StreamReader, lives: Mapping[int, Longs], drops: Sequence[Drop], folder: Path
) -> list[Path]:
    """Writes for each of `drops` what it keeps as a stream like that of `reader`, in a folder of
    its own below `folder`; gives the folders."""
    manifest = reader.manifest
    paths = [folder / str(number) for number in range(len(drops))]
    with contextlib.ExitStack() as stack:
        writers = [stack.enter_context(StreamWriter.create(path, manifest)) for path in paths]
        # By drop and lane.
        sent = np.zeros((len(drops), manifest.swin_size, manifest.slice_size), np.bool_)
        for birth, decoder, statuses in recorded_slices(reader):
            for before, drop, writer in zip(
                sent[:, birth % manifest.swin_size], drops, writers, strict=True
            ):
                kept = drop.kept(lives[birth])
                said = statuses_of_kept(statuses, before, kept)
                writer.append(recorded_update(decoder, birth, said))
                before[:] = kept
    return paths
