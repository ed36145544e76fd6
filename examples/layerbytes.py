"""Prints the bytes of every layer of a stream, and the PSNR of 1, 2, ... layers.

Only the manifest and the index are read, not the Gaussians.

python examples/layerbytes.py demo/stream
"""

import sys
from pathlib import Path

from codec.stream import StreamReader

reader = StreamReader(Path(sys.argv[1]))
frames, fps = reader.num_frames, reader.manifest.fps
total_bytes = 0
for layer in range(reader.manifest.num_layers):
    layer_bytes = sum(record.object_bytes[layer] for record in reader.records)
    total_bytes += layer_bytes
    psnr_db = sum(r.psnr_db[layer] * r.num_frames for r in reader.records) / frames
    print(
        f"layer {layer}: {layer_bytes / frames / 1e3:.2f} kB a frame; up to here "
        f"{8 * total_bytes / frames * fps / 1e6:.2f} Mbit/s, {psnr_db:.2f} dB"
    )
for name, part in (("skipmaps", slice(0, 1)), ("keyframes, fetched on joining", slice(1, None))):
    side_bytes = sum(sum(record.side_bytes[part]) for record in reader.records)
    print(f"{name}: {side_bytes / frames / 1e3:.2f} kB a frame")
