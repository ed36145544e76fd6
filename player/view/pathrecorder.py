"""Records the camera's path while a stream plays, as key frames that keyframes.py reads.

Rule: pure; the window says which camera showed in which frame, and writes the bytes.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable

import numpy as np

from codec.camera import Camera
from codec.pose import Doubles, quat_of

MAX_FRAMES = 30_000
"""Most recorded frames, 16 minutes at 30 a second: their file is one that keyframes.py reads."""

TOLERANCE_PX = 0.5
"""Largest displacement in the picture that leaving out key frames may cause."""

LEAST_DISTANCE_M = 0.1
"""Least distance to the scene's centre with which a step of the camera becomes pixels."""

LEAST_COSINE = 0.1
"""Least cosine between the quaternions of two key frames: nearly half a turn is ambiguous."""


def moved_px(a: Camera, b: Camera, centre: Doubles) -> float:
    """How far, at most and about, the scene's `centre` and what is as far away moves in the picture
    between two cameras, in pixels of `b`."""
    one, other = _Poses([a], centre), _Poses([b], centre)
    return float(other.errors_px(slice(0, 1), one.positions, one.quats, one.focals)[0])


class _Poses:
    """Cameras as arrays, in the order of their frames."""

    def __init__(self, cameras: Iterable[Camera], centre: Doubles) -> None:
        cameras = list(cameras)
        self.positions = np.array([camera.position for camera in cameras])  # (N, 3)
        self.quats = np.array([quat_of(camera.w2c[:3, :3]) for camera in cameras])  # (N, 4)
        self.focals = np.array([camera.fy_px / camera.height_px for camera in cameras])
        self._heights_px = np.array([camera.height_px for camera in cameras], np.float64)
        away = np.linalg.norm(self.positions - centre, axis=1)
        self._distances_m = np.maximum(away, LEAST_DISTANCE_M)

    def errors_px(
        self, rows: slice, positions: Doubles, quats: Doubles, focals: Doubles
    ) -> Doubles:
        """(M,) see `moved_px`: of the cameras `rows`, where others stand in their place."""
        # By the chord, which is exact near zero where arccos is not.
        ours = self.quats[rows]
        chords = np.minimum(
            np.linalg.norm(quats - ours, axis=1), np.linalg.norm(quats + ours, axis=1)
        )
        turns_rad = 4 * np.arcsin(np.minimum(chords / 2, 1))
        steps = np.linalg.norm(positions - self.positions[rows], axis=1) / self._distances_m[rows]
        zooms = np.abs(focals / self.focals[rows] - 1)
        heights_px = self._heights_px[rows]
        focals_px = self.focals[rows] * heights_px
        errors_px: Doubles = focals_px * (turns_rad + steps) + zooms * heights_px / 2
        return errors_px

    def between_px(self, frames: Doubles, first: int, last: int) -> Doubles:
        """(last - first - 1,) errors of the cameras between two rows, if those alone are key
        frames; infinite if it is not clear which way the camera turns."""
        rows = slice(first + 1, last)
        cosine = float(self.quats[first] @ self.quats[last])
        if abs(cosine) < LEAST_COSINE:
            return np.full(last - first - 1, np.inf)
        shares = ((frames[rows] - frames[first]) / (frames[last] - frames[first]))[:, None]
        angle_rad = math.acos(min(1.0, abs(cosine)))
        end = math.copysign(1.0, cosine) * self.quats[last]
        if angle_rad < 1e-6:
            quats = (1 - shares) * self.quats[first] + shares * end
        else:
            quats = np.sin((1 - shares) * angle_rad) * self.quats[first]
            quats += np.sin(shares * angle_rad) * end
        quats /= np.linalg.norm(quats, axis=1, keepdims=True)
        positions = (1 - shares) * self.positions[first] + shares * self.positions[last]
        focals = (1 - shares[:, 0]) * self.focals[first] + shares[:, 0] * self.focals[last]
        return self.errors_px(rows, positions, quats, focals)


class PathRecorder:
    """The camera of each frame shown. A frame that shows again, in a loop or after a seek, is
    recorded anew; what lies between recorded frames is for the key frames to fill."""

    def __init__(self, centre: Doubles) -> None:
        """centre: (3,) of the scene, metres: how far away is what should stay in its place."""
        self._centre = centre
        self._cameras: dict[int, Camera] = {}

    def __len__(self) -> int:
        """Frames recorded."""
        return len(self._cameras)

    def add(self, frame: int, camera: Camera) -> bool:
        """Notes that `camera` showed `frame`; gives whether there was room for it."""
        if frame not in self._cameras and len(self._cameras) >= MAX_FRAMES:
            return False
        self._cameras[frame] = camera
        return True

    def clear(self) -> None:
        self._cameras.clear()

    def keyframes(self, tolerance_px: float = TOLERANCE_PX) -> list[tuple[int, Camera]]:
        """Some of the frames, rising, and their cameras: in every other recorded frame the path
        between them is within `tolerance_px` of the camera that showed, by `moved_px`."""
        taken = sorted(self._cameras.items())
        if len(taken) < 3:
            return taken
        frames = np.array([frame for frame, _ in taken], np.float64)
        poses = _Poses((camera for _, camera in taken), self._centre)
        kept, spans = {0, len(taken) - 1}, [(0, len(taken) - 1)]
        while spans:
            first, last = spans.pop()
            if last - first < 2:
                continue
            errors_px = poses.between_px(frames, first, last)
            # Of equally bad ones the middle one, so that the spans become short soon.
            worst = np.flatnonzero(errors_px == errors_px.max())
            middle = first + 1 + int(worst[len(worst) // 2])
            if errors_px[middle - first - 1] > tolerance_px:
                kept.add(middle)
                spans += [(first, middle), (middle, last)]
        return [taken[row] for row in sorted(kept)]

    def to_json(self, tolerance_px: float = TOLERANCE_PX) -> bytes:
        """The key frames as the JSON file that `--camera` takes: see keyframes.py. Of a camera's
        lens it holds the vertical field of view."""
        entries = []
        for frame, camera in self.keyframes(tolerance_px):
            fov_deg = 2 * math.degrees(math.atan(camera.height_px / 2 / camera.fy_px))
            w2c = [float(number) for number in camera.w2c.ravel()]
            entries.append({"frame": frame, "w2c": w2c, "fov_deg": fov_deg})
        lines = ",\n ".join(json.dumps(entry) for entry in entries)
        return f"[{lines}]\n".encode()
