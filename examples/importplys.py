"""Makes a stream of a folder with a numbered PLY for each frame, and prints what it cost.

python examples/importplys.py my-frames 30 my-stream
"""

import sys
from pathlib import Path

from codec.sequence.importing import ImportOptions, import_stream

folder, fps, stream = Path(sys.argv[1]), float(sys.argv[2]), Path(sys.argv[3])
made = import_stream(folder, stream, ImportOptions(fps=fps, layers=3))
kept, ended, predicted, new = made.statuses
print(f"{made.num_frames} frames, {made.played_bytes / made.num_frames / 1e3:.1f} kB each to play")
print(f"{kept} Gaussians kept, {predicted} sent as differences, {new} new, {ended} ended")
