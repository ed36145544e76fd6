"""Cost of slots that last: bytes of a slice, and time to encode and decode it.

Usage: scripts/bench slots [--num-slots N] [--active SHARE]
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from rich.console import Console
from rich.table import Table

from codec.console import run_command
from codec.slots.decoder import SlotDecoder
from codec.slots.encoder import SlotEncoder
from codec.slots.slotlayout import Update
from codec.stream.segment import encode_packet, packet_content
from tests.support.slots.trained_updates import trained_like_layout, trained_like_updates

SWIN_SIZE = 2
NUM_FRAMES = 24
SEGMENT_FRAMES = 30


@dataclass(frozen=True, slots=True)
class SlotsConfig:
    """Measures skip maps, changes and keyframes on one core."""

    num_slots: int = 30_000
    """Slots in a lane."""
    active: float = 0.3
    """Share of the slots that a slice changes; nine tenths of the changed slots are predicted, the
    others new or ended."""


def median_ms(works: Sequence[Callable[[], object]]) -> float:
    """Median of the thread's CPU time, which equals wall time if the core is free."""
    times = []
    for work in works:
        start = time.thread_time()
        work()
        times.append(time.thread_time() - start)
    return 1e3 * float(np.median(times))


def run(config: SlotsConfig) -> None:
    layout = trained_like_layout(config.num_slots, SWIN_SIZE, SEGMENT_FRAMES)
    updates = list(trained_like_updates(layout, NUM_FRAMES, config.active))
    encoder, decoder = SlotEncoder(layout), SlotDecoder(layout)
    for update in updates[:SWIN_SIZE]:
        encoder.append(update)
    keyframes = [encode_packet(chunk) for chunk in encoder.keyframes()]
    limits = [layout.max_keyframe_bytes(n) for n in range(layout.num_layers)]
    start = time.thread_time()
    for data, limit in zip(keyframes, limits, strict=True):
        decoder.load(packet_content(data, limit))
    join_ms = 1e3 * (time.thread_time() - start)
    sent: list[tuple[bytes, list[bytes]]] = []

    def encode(update: Update) -> None:
        made = encoder.append(update)
        assert made is not None
        sent.append(
            (encode_packet(made.skip_map), [encode_packet(change) for change in made.changes])
        )

    def decode(birth: int, skip_map: bytes, changes: list[bytes]) -> None:
        decoder.apply(
            birth,
            packet_content(skip_map, layout.max_skip_map_bytes),
            [packet_content(c, layout.max_change_bytes(n)) for n, c in enumerate(changes)],
        )

    late = updates[SWIN_SIZE:]
    encode_ms = median_ms([partial(encode, update) for update in late])
    decode_ms = median_ms(
        [partial(decode, update.birth, *parts) for update, parts in zip(late, sent, strict=True)]
    )
    whole_ms = median_ms([partial(decoder.whole, late[-1].birth)] * 9)
    a_slot = sum(map(len, keyframes)) / (SWIN_SIZE * config.num_slots)
    changed = np.mean([np.count_nonzero(update.statuses) for update in late])
    coded = np.mean([len(update.states) for update in late])
    skip_map_bytes = np.mean([len(skip_map) for skip_map, _ in sent])
    change_bytes = np.mean([sum(map(len, changes)) for _, changes in sent])
    table = Table(
        title=f"{config.num_slots} slots in {layout.num_layers} layers", show_header=False
    )
    facts = {
        "slots changed in a slice": f"{changed:.0f}",
        "packets -> applied slice (median)": f"{decode_ms:.2f} ms",
        "update -> packets (median)": f"{encode_ms:.1f} ms",
        "a lane as a whole slice": f"{whole_ms:.2f} ms",
        f"keyframes of {SWIN_SIZE} lanes loaded": f"{join_ms:.1f} ms",
        "skip map": f"{skip_map_bytes:.0f} bytes, "
        f"{8 * skip_map_bytes / config.num_slots:.2f} bits a slot",
        "changes": f"{change_bytes:.0f} bytes, {change_bytes / coded:.2f} a predicted or new one",
        "keyframes": f"{a_slot:.2f} bytes a slot",
    }
    for name, value in facts.items():
        table.add_row(name, value)
    Console(width=100).print(table)


if __name__ == "__main__":
    run_command(SlotsConfig, run, "scripts/bench slots", "Measures slots that last.")
