"""Cost of a Gaussian in a slice that is sent whole, in bytes and in time; `scripts/bench slots`
measures slots that last.

Usage: scripts/bench encode
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from rich.console import Console
from rich.table import Table

from codec.coders.coder import EncodedChunk
from codec.coders.zstd import compress
from codec.console import run_command
from codec.lattice.lattice import Lattice
from codec.slice import Slice
from codec.slots.decoder import SlotDecoder
from codec.slots.encoder import SlotEncoder
from codec.slots.slotlayout import SlotLayout, Update
from codec.stream.segment import encode_packet, packet_content
from codec.stream.wholeslice import opacity_rank, split_counts, whole_update
from tests.support.trained_like import trained_like_splats

NUM_GS = 40_000
CASES = [(1, (1.0,)), (5, (1.0,)), (5, (0.25,) * 4), (20, (0.25,) * 4)]
"""Number of slices that the Gaussians are dealt to, and the shares of the layers of each."""
REPEATS = 5


@dataclass(frozen=True, slots=True)
class EncodeConfig:
    """Measures the cost of Gaussians, in bytes and in time."""


def median_ms(work: Callable[[], object]) -> float:
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times))


def synthetic_slices(count: int) -> list[Slice]:
    """`count` slices, due at frame 1, of a trained-like scene of NUM_GS Gaussians. The Gaussians
    are dealt to the slices at random, as slots are."""
    splats = trained_like_splats(NUM_GS)
    deal = np.random.default_rng(0).permutation(NUM_GS)
    parts = np.array_split(deal, count)
    return [Slice(1, splats.take(rows), np.zeros(len(rows), np.uint8)) for rows in parts]


def encode_slice(slice: Slice, layout: SlotLayout, exact: bool) -> list[EncodedChunk]:
    """The skip map of `slice` and its change of each layer, as the writer encodes them."""
    encoder = SlotEncoder(layout)
    encoder.append(Update.keeping(0, layout))
    made = encoder.append(whole_update(slice, layout, opacity_rank, exact))
    assert made is not None
    return [made.skip_map, *made.changes]


def decode_slice(parts: list[bytes], layout: SlotLayout) -> Slice:
    decoder, empty = SlotDecoder(layout), SlotEncoder(layout)
    empty.append(Update.keeping(0, layout))
    for chunk in empty.keyframes():
        decoder.load(chunk.data)
    decoder.apply(1, parts[0], parts[1:])
    return decoder.whole(1)


def pack(chunks: list[EncodedChunk]) -> list[bytes]:
    return [encode_packet(chunk) for chunk in chunks]


def inflate_and_decode(packets: list[bytes], layout: SlotLayout) -> Slice:
    limits = [layout.max_skip_map_bytes, *map(layout.max_change_bytes, range(layout.num_layers))]
    parts = [packet_content(data, limit) for data, limit in zip(packets, limits, strict=True)]
    return decode_slice(parts, layout)


def table_of_cases() -> Table:
    table = Table(title=f"{NUM_GS} trained-like Gaussians")
    for name in ("as", "slices", "layers", "bytes/Gaussian"):
        table.add_column(name, justify="right")
    for name in ("quantise", "entropy code", "decode", "inflate + decode"):
        table.add_column(f"{name} ms/slice", justify="right")
    for exact in (True, False):
        for count, shares in CASES:
            slices = synthetic_slices(count)
            lattice = Lattice.suiting(slices[0].splats)
            slots = split_counts(-(-NUM_GS // count), shares)
            layout = SlotLayout(1, slots, 0, (lattice,) * len(slots), 2)
            chunks = [encode_slice(one, layout, exact) for one in slices]
            packets = list(map(pack, chunks))
            parts = [chunk.data for chunk in chunks[0]]
            times = (
                median_ms(partial(encode_slice, slices[0], layout, exact)),
                median_ms(partial(pack, chunks[0])),
                median_ms(partial(decode_slice, parts, layout)),
                median_ms(partial(inflate_and_decode, packets[0], layout)),
            )
            size = sum(len(packet) for of_slice in packets for packet in of_slice) / NUM_GS
            name = "float32" if exact else "lattice"
            row = (name, str(count), str(len(shares)), f"{size:.2f}")
            table.add_row(*row, *(f"{ms:.2f}" for ms in times))
    return table


def table_of_attributes(slice: Slice) -> Table:
    """Bits of each attribute on the lattice, each coded in zstd blocks of its own."""
    count = len(slice.splats)
    layout = SlotLayout(1, (count,), 0, (Lattice.suiting(slice.splats),), 2)
    _, change = encode_slice(slice, layout, exact=False)
    groups = {"counts": 1, "position": 3, "scales": 3, "rotation": 3, "luma": 1, "chroma": 2}
    groups |= {"opacity": 1, "position (low bits)": 1}
    empty_bytes, edges, at = len(compress(b"\0", [0, 1])), change.edges, 0
    table = Table(title=f"{count} Gaussians on the lattice: bits a Gaussian")
    table.add_column("attribute")
    table.add_column("bits", justify="right")
    total = 0.0
    for name, planes in groups.items():
        last = at + planes
        inner = [edge - edges[at] for edge in edges[at : last + 1]]
        size = len(compress(change.data[edges[at] : edges[last]], inner)) - empty_bytes + 4
        table.add_row(name, f"{8 * size / count:.2f}")
        total, at = total + size, last
    total += edges[-1] - edges[at]
    table.add_row("escapes", f"{8 * (edges[-1] - edges[at]) / count:.2f}")
    table.add_row("sum", f"{8 * total / count:.2f}")
    return table


def run(config: EncodeConfig) -> None:
    console = Console(width=150)
    console.print(table_of_cases())
    console.print(table_of_attributes(synthetic_slices(5)[0]))


if __name__ == "__main__":
    run_command(EncodeConfig, run, "scripts/bench encode", "Measures the cost of a Gaussian.")
