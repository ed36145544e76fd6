"""What a Gaussian costs in each profile, in bytes and in time.

Usage: scripts/bench encode [STREAM]. With the folder of a `raw` stream it tells only what each
attribute of the slice born in frame 0 costs.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, TypeVar

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from codec.coders.coder import EncodedChunk, compress
from codec.console import run_command
from codec.profiles.profile import CHUNK_PROFILES, Profile
from codec.slice import Slice
from codec.stream import StreamReader
from codec.stream.chunk import decode_chunk, encode_chunk
from codec.stream.layers import opacity_rank, split_layers
from codec.stream.object import decode_packet, encode_packet
from tests.support.trained_like import trained_like_splats

NUM_GS = 40_000
CASES = [(1, (1.0,)), (5, (1.0,)), (5, (0.25,) * 4), (20, (0.25,) * 4)]
"""Slices that the Gaussians are dealt to, and the layers of each."""
REPEATS = 5


@dataclass(frozen=True, slots=True)
class EncodeConfig:
    """Measures the cost of Gaussians, in bytes and in time."""

    stream: Annotated[tyro.conf.Positional[Path | None], tyro.conf.arg(metavar="[STREAM]")] = None
    """Folder of a stream of profile raw; measures only the bits of each attribute of one slice."""


def median_ms(work: Callable[[], object]) -> float:
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times))


Part = TypeVar("Part")


def each(work: Callable[[Part], object], parts: list[Part]) -> None:
    for part in parts:
        work(part)


def synthetic_slices(count: int) -> list[Slice]:
    """`count` slices of a trained-like scene of NUM_GS Gaussians, dealt at random as slots are."""
    splats = trained_like_splats(NUM_GS)
    deal = np.random.default_rng(0).permutation(NUM_GS)
    parts = np.array_split(deal, count)
    return [
        Slice(n, splats.take(rows), np.zeros(len(rows), np.uint8)) for n, rows in enumerate(parts)
    ]


def encode_slice(slice: Slice, shares: tuple[float, ...], profile: Profile) -> list[EncodedChunk]:
    """The chunks of the layers of `slice`, as the writer makes them."""
    parts = split_layers(slice, shares, opacity_rank)
    steps = profile.coding.layer_steps([part.splats for part in parts])
    return [encode_chunk(part, n, profile, steps[n]) for n, part in enumerate(parts)]


def table_of_cases() -> Table:
    table = Table(title=f"{NUM_GS} trained-like Gaussians")
    for name in ("profile", "slices", "layers", "bytes/Gaussian"):
        table.add_column(name, justify="right")
    for name in ("quantise", "entropy code", "decode", "inflate + decode"):
        table.add_column(f"{name} ms/slice", justify="right")
    for profile in CHUNK_PROFILES:
        for count, shares in CASES:
            slices = synthetic_slices(count)
            chunks = [c for s in slices for c in encode_slice(s, shares, profile)]
            packets = [encode_packet(chunk) for chunk in chunks]
            one, coded = chunks[: len(shares)], packets[: len(shares)]
            total = sum(len(s.splats) for s in slices)
            times = (
                median_ms(partial(encode_slice, slices[0], shares, profile)),
                median_ms(partial(each, encode_packet, one)),
                median_ms(partial(each, decode_chunk, [chunk.data for chunk in one])),
                median_ms(partial(each, decode_packet, coded)),
            )
            size = sum(map(len, packets)) / total
            row = (profile.value, str(len(slices)), str(len(shares)), f"{size:.2f}")
            table.add_row(*row, *(f"{ms:.2f}" for ms in times))
    return table


def table_of_attributes(slice: Slice) -> Table:
    """What each attribute of profile `compact` costs, each in zstd blocks of its own."""
    groups = {"head": 1, "position (gaps)": 1, "scales": 3, "rotation": 3, "opacity": 1}
    coefficients = slice.splats.sh.shape[1]
    groups |= {"luma": coefficients, "chroma": 2 * coefficients, "position (low bits)": 1}
    sizes = dict.fromkeys([*groups, "escapes, offsets"], 0)
    for chunk in encode_slice(slice, (0.25,) * 4, Profile.COMPACT):
        edges, at = chunk.edges, 0
        empty_bytes = len(compress(b"\0", [0, 1]))
        for name, planes in groups.items():
            last = min(at + planes, len(edges) - 1)
            start, end = edges[at], edges[last]
            inner = [edge - start for edge in edges[at : last + 1]]
            sizes[name] += len(compress(chunk.data[start:end], inner)) - empty_bytes + 4
            at = last
        sizes["escapes, offsets"] += edges[-1] - edges[at]
    table = Table(title=f"compact, {len(slice.splats)} Gaussians in 4 layers: bits a Gaussian")
    table.add_column("attribute")
    table.add_column("bits", justify="right")
    for name, size in sizes.items():
        table.add_row(name, f"{8 * size / len(slice.splats):.2f}")
    table.add_row("sum", f"{8 * sum(sizes.values()) / len(slice.splats):.2f}")
    return table


def run(config: EncodeConfig) -> None:
    console = Console(width=150)
    if config.stream is not None:
        reader = StreamReader(config.stream)
        console.print(table_of_attributes(reader.slice(0, reader.manifest.num_layers)))
        return
    console.print(table_of_cases())
    console.print(table_of_attributes(synthetic_slices(5)[0]))


if __name__ == "__main__":
    run_command(EncodeConfig, run, "scripts/bench encode", "Measures the cost of a Gaussian.")
