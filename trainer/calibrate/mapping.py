"""Rigs from pictures, by pycolmap, in a process of its own: python -m trainer.calibrate.mapping
FOLDER. In one process with PyAV and numba, pycolmap ended with a double free.

FOLDER holds job.json (see `Job`) and pictures/<moment>_<camera>.jpg; result.npz is written (see
solution.py, which reads it). The cameras stand still while the scene moves, so features and matches
of many moments are pooled, as if each camera had taken one picture with all of them.

The moments are cut into two halves, and each half gives a rig of its own: two rigs that agree were
not found by chance, and the moments of one half are unseen by the rig of the other. Where nothing
tells yet when each camera began, only what stands still is compared, and gives one rig.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from codec.arrays import Doubles, Flags, Longs

from .bundle import Bundle, adjusted

JOB_NAME, RESULT_NAME, PICTURES_NAME = "job.json", "result.npz", "pictures"

SCOUT_MOMENTS = 4
"""Moments in which every two cameras are compared; in the others only those two that share some of
what these show, so that 60 cameras do not take 1,770 comparisons a moment."""

LEAST_SHARED = 15
"""Verified matches over the scout moments from which on two cameras are compared in the others."""

FOCAL_GUESS = 1.2
"""Focal length over the longer side before anything is known: COLMAP's own guess."""

LENSES = ("like", "free")
"""How lenses are found. like: one for all cameras of a kind, then one for each that is like them.
free: one for each from the start. Cameras that are alike need the first, or rigs of few points come
out wrong; those that differ need the other. Unseen moments decide.
"""

SAME_PX = 1.0
"""Side of the squares of a camera's picture of which each is one keypoint in all moments."""

MOST_SEEN = 2
"""Moments in which at most a keypoint is found that moves."""

ERROR_PX, LEAST_FITTING = 2.0, 0.25
"""How far a match may lie off the geometry of two cameras, at 640 pixels of width, and the share of
matches that must fit: by chance, a tenth of them do."""

LEAST_STILL, LEAST_MATCHES = 8, 30
"""So many matches of a picture with another of the same camera show what stands still, if it did;
with fewer matches that cannot be told."""

MAX_TRIALS = 3000
"""Samples when the matches of two cameras are verified."""

Pair = tuple[int, int]
Arrays = dict[str, npt.NDArray[Any]]


@dataclass(frozen=True)
class Job:
    """What the process is asked for."""

    sizes_px: Sequence[tuple[int, int]]
    """Width and height of each camera's pictures."""
    kinds: Sequence[int]
    """For each camera the number of its kind: those of one kind have one lens at first."""
    halves: tuple[Sequence[int], Sequence[int]]
    """The moments of each half."""
    in_step: bool
    """Whether the pictures of a moment show one; if not, what moves in them is not compared."""
    features: int
    """Most features of a picture."""
    threads: int
    seed: int = 0

    def write(self, folder: Path) -> None:
        (folder / JOB_NAME).write_text(json.dumps(asdict(self)))


def picture_name(moment: int, camera: int) -> str:
    return f"{moment:05d}_{camera:05d}.jpg"


def pooled(keypoints: Doubles) -> tuple[Doubles, Longs, Flags]:
    """(K, 3) the different ones of keypoints (N, 3) x, y, moment of a camera, in the mean of their
    places and the first of their moments; (N,) which of them each is; and (K,) whether it moves.
    What stands still is found in every moment and is one keypoint: else each wrong match would be
    there many times, and copies bear each other out."""
    _, first, numbers, count = np.unique(
        np.floor(keypoints[:, :2] / SAME_PX), axis=0,
        return_index=True, return_inverse=True, return_counts=True,
    )  # fmt: skip
    numbers = numbers.ravel()
    means = [np.bincount(numbers, keypoints[:, i]) / count for i in (0, 1)]
    return np.column_stack([*means, keypoints[first, 2]]), numbers, count <= MOST_SEEN


def is_borne_out(found: Flags, fits: Flags) -> bool:
    """Whether matches of two cameras are more than chance. found, fits: of all of them, and of
    those that fit one geometry, whether each moves.

    A pattern that repeats itself, as that of a floor does, gives many wrong matches that fit each
    other. It stands still: what moves, if anything does, tells.
    """
    if found.sum() < LEAST_SHARED:
        return len(fits) >= LEAST_FITTING * len(found)
    return bool(fits.sum() >= LEAST_FITTING * found.sum())


class Mapper:
    """Finds rigs in FOLDER."""

    def __init__(self, folder: Path, job: Job) -> None:
        self._colmap: Any = import_module("pycolmap")
        self._folder, self._job = folder, job
        self._cameras = range(len(job.sizes_px))
        self._moments = [moment for half in job.halves for moment in half]
        self._scale = max(1.0, max(max(size) for size in job.sizes_px) / 640)
        self._colmap.set_random_seed(job.seed)
        self._pictures = folder / "pictures.db"
        (folder / "none").mkdir()

    def run(self) -> Arrays:
        options = self._colmap.FeatureExtractionOptions()
        options.sift.max_num_features = self._job.features
        options.num_threads = self._job.threads
        mode = self._colmap.CameraMode.PER_IMAGE
        pictures = self._folder / PICTURES_NAME
        self._colmap.extract_features(
            self._pictures, pictures, camera_mode=mode, extraction_options=options
        )
        self._progress(0.3)
        self._read_keypoints()
        pairs = [(a, b) for a in self._cameras for b in self._cameras[a + 1 :]]
        scouts = self._moments[:: max(1, len(self._moments) // SCOUT_MOMENTS)]
        self._match([((m, a), (m, b)) for m in scouts for a, b in pairs])
        shared = self._verified(pairs, scouts)
        pairs = [pair for pair in pairs if len(shared[pair]) >= LEAST_SHARED]
        rest = [m for m in self._moments if m not in scouts]
        self._match([((m, a), (m, b)) for m in rest for a, b in pairs])
        self._progress(0.5)
        result: Arrays = {f"keypoints{c}": self.keypoints[c] for c in self._cameras}
        if not self._job.in_step:
            return result | self.rigs("whole", self._verified(pairs, self._moments))
        result["moved"] = self._moved()
        both = {pair: np.zeros((0, 2), np.int64) for pair in pairs}
        for name, half in zip(("first", "second"), self._job.halves, strict=True):
            verified = self._verified(pairs, half)
            for (a, b), matches in verified.items():
                result[f"matches_{name}_{a}_{b}"] = matches
                both[a, b] = np.unique(np.concatenate([both[a, b], matches]), axis=0)
            result |= self.rigs(name, verified)
            self._progress(0.7 if name == "first" else 0.8)
        return result | self.rigs("whole", both)

    def _progress(self, share: float) -> None:
        """A line that the parent reads."""
        sys.stdout.write(f"progress {share}\n")
        sys.stdout.flush()

    def _read_keypoints(self) -> None:
        """The pooled keypoints of each camera, and the numbers of those of each picture among
        them."""
        database = self._colmap.Database.open(self._pictures)
        self._ids = {image.name: image.image_id for image in database.read_all_images()}
        self.keypoints: list[Doubles] = []
        self._moves: list[Flags] = []
        self._numbers: dict[tuple[int, int], Longs] = {}
        for camera in self._cameras:
            names = [picture_name(moment, camera) for moment in self._moments]
            found = [np.asarray(database.read_keypoints(self._ids[n]))[:, :2] for n in names]
            moments = np.repeat(self._moments, [len(each) for each in found])
            xy = np.concatenate(found).astype(np.float64)
            keypoints, numbers, moves = pooled(np.column_stack([xy, moments]))
            self.keypoints.append(keypoints)
            self._moves.append(moves)
            for moment in self._moments:
                self._numbers[moment, camera] = numbers[moments == moment]
        database.close()

    def _match(self, pairs: Sequence[tuple[tuple[int, int], tuple[int, int]]]) -> None:
        """Matches pictures, each a moment and a camera."""
        options = self._colmap.FeatureMatchingOptions()
        options.num_threads = self._job.threads
        options.skip_geometric_verification = True  # one moment has too few; it follows, pooled
        listed = self._folder / "pairs.txt"
        lines = [f"{picture_name(*one)} {picture_name(*other)}\n" for one, other in pairs]
        listed.write_text("".join(lines))
        pairing = self._colmap.ImportedPairingOptions()
        pairing.match_list_path = str(listed)
        self._colmap.match_image_pairs(self._pictures, options, pairing)

    def _matches(self, database: Any, one: tuple[int, int], other: tuple[int, int]) -> Longs:
        """(N, 2) pooled keypoints that match in two pictures, each a moment and a camera."""
        ids = self._ids[picture_name(*one)], self._ids[picture_name(*other)]
        found = np.asarray(database.read_matches(*ids)).reshape(-1, 2).astype(np.int64)
        return np.column_stack([self._numbers[one][found[:, 0]], self._numbers[other][found[:, 1]]])

    def _moved(self) -> Doubles:
        """(C, M) by how many pixels the still part of a picture lies elsewhere than in the middle
        moment; NaN where too few match."""
        middle = self._moments[len(self._moments) // 2]
        others = [m for m in self._moments if m != middle]
        self._match([((middle, c), (m, c)) for c in self._cameras for m in others])
        database = self._colmap.Database.open(self._pictures)
        moved = np.zeros((len(self._cameras), len(self._moments)))
        for camera in self._cameras:
            for column, moment in enumerate(self._moments):
                matches = self._matches(database, (middle, camera), (moment, camera))
                if moment != middle:
                    a, b = self.keypoints[camera][matches.T, :2]
                    away = np.sort(np.hypot(*(a - b).T))
                    few = len(matches) < LEAST_MATCHES
                    moved[camera, column] = np.nan if few else away[LEAST_STILL - 1]
        database.close()
        return moved

    def _verified(self, pairs: Sequence[Pair], moments: Sequence[int]) -> dict[Pair, Longs]:
        """(N, 2) matches of each two cameras in the moments that one geometry explains."""
        colmap = self._colmap
        database = colmap.Database.open(self._pictures)
        found = {}
        for a, b in pairs:
            each = [self._matches(database, (m, a), (m, b)) for m in moments]
            matches = np.unique(np.concatenate(each), axis=0)
            if not self._job.in_step:
                moves = self._moves[a][matches[:, 0]] | self._moves[b][matches[:, 1]]
                matches = matches[~moves]
            found[a, b] = matches
        database.close()
        options = colmap.TwoViewGeometryOptions()
        options.ransac.random_seed = self._job.seed
        options.ransac.max_num_trials = MAX_TRIALS
        options.ransac.max_error = ERROR_PX * self._scale
        lenses = [self._lens(camera) for camera in self._cameras]

        def verify(pair: Pair) -> Longs:
            a, b = pair
            geometry = colmap.estimate_two_view_geometry(
                lenses[a], self.keypoints[a][:, :2], lenses[b], self.keypoints[b][:, :2],
                found[pair].astype(np.uint32), options,
            )  # fmt: skip
            fits = np.asarray(geometry.inlier_matches).reshape(-1, 2).astype(np.int64)
            moves = (self._moves[a][m[:, 0]] & self._moves[b][m[:, 1]] for m in (found[pair], fits))
            return fits if is_borne_out(*moves) else fits[:0]

        with ThreadPoolExecutor(self._job.threads) as pool:
            return dict(zip(pairs, pool.map(verify, pairs), strict=True))

    def _lens(self, camera: int) -> Any:
        width, height = self._job.sizes_px[camera]
        model = self._colmap.CameraModelId.SIMPLE_RADIAL
        focal_px = FOCAL_GUESS * max(width, height)
        return self._colmap.Camera.create_from_model_id(0, model, focal_px, width, height)

    def _write(self, name: str, verified: Mapping[Pair, Longs], kinds: Sequence[int]) -> None:
        """Writes the database NAME.db, with an image for each camera, image N + 1 of camera N."""
        colmap = self._colmap
        database = colmap.Database.open(self._folder / f"{name}.db")
        lenses: dict[int, tuple[Any, int]] = {}
        for camera, kind in enumerate(kinds):
            if kind not in lenses:
                lens_id = database.write_camera(self._lens(camera))
                sensor = colmap.sensor_t(type=colmap.SensorType.CAMERA, id=lens_id)
                rig = colmap.Rig()
                rig.add_ref_sensor(sensor)
                lenses[kind] = sensor, database.write_rig(rig)
            sensor, rig_id = lenses[kind]
            image = colmap.Image(name=str(camera), camera_id=sensor.id)
            image_id = database.write_image(image)
            frame = colmap.Frame()
            frame.rig_id = rig_id
            frame.add_data_id(colmap.data_t(sensor_id=sensor, id=image_id))
            database.write_frame(frame)
            xy = np.ascontiguousarray(self.keypoints[camera][:, :2], np.float32)
            database.write_keypoints(image_id, xy)
        for (a, b), matches in verified.items():
            if len(matches):
                geometry = colmap.TwoViewGeometry()
                geometry.config = colmap.TwoViewGeometryConfiguration.UNCALIBRATED
                geometry.inlier_matches = matches.astype(np.uint32)
                database.write_matches(a + 1, b + 1, matches.astype(np.uint32))
                database.write_two_view_geometry(a + 1, b + 1, geometry)
        database.close()

    def rigs(self, name: str, verified: Mapping[Pair, Longs]) -> Arrays:
        """The rigs of verified matches, with each of LENSES: arrays by name, of which there are
        none where no rig was found."""

        def with_lenses(lens: str) -> Arrays:
            kinds = self._job.kinds if lens == "like" else self._cameras
            model = self._mapped(f"{name}_{lens}", verified, kinds)
            rig = {} if model is None else self._rig(model, kinds)
            return {f"{name}_{lens}_{key}": value for key, value in rig.items()}

        found: Arrays = {}
        with ThreadPoolExecutor(min(self._job.threads, len(LENSES))) as pool:
            for rig in pool.map(with_lenses, LENSES):
                found |= rig
        return found

    def _mapped(self, name: str, verified: Mapping[Pair, Longs], kinds: Sequence[int]) -> Any:
        """The largest rig with one lens for each kind; None if there is none."""
        options = self._colmap.IncrementalPipelineOptions()
        options.extract_colors = False
        options.num_threads = max(1, self._job.threads // len(LENSES))  # see `rigs`
        options.random_seed = self._job.seed
        options.min_model_size = 3
        self._write(name, verified, kinds)
        out = self._folder / f"{name}.rig"
        out.mkdir()
        models = self._colmap.incremental_mapping(
            self._folder / f"{name}.db", self._folder / "none", out, options
        )
        return max(models.values(), key=lambda each: each.num_reg_images(), default=None)

    def _rig(self, model: Any, kinds: Sequence[int]) -> Arrays:
        """The rig, adjusted, as the fields of `solution.Rig`."""
        images = sorted((model.image(i) for i in model.reg_image_ids()), key=lambda i: i.image_id)
        cameras = [int(image.name) for image in images]
        rows = {image.image_id: row for row, image in enumerate(images)}
        seen = np.array([
            (rows[element.image_id], number, element.point2D_idx)
            for number, point in enumerate(model.points3D.values())
            for element in point.track.elements
        ], np.int64).reshape(-1, 3)  # fmt: skip
        xy_px = [self.keypoints[cameras[row]][keypoint, :2] for row, _, keypoint in seen]
        bundle = adjusted(
            Bundle(
                np.array([model.camera(image.camera_id).params for image in images]),
                np.array([image.cam_from_world().matrix() for image in images]),
                np.array([p.xyz for p in model.points3D.values()]).reshape(-1, 3),
                seen[:, 0],
                seen[:, 1],
                seen[:, 2],
                np.array(xy_px).reshape(-1, 2),
            ),
            [kinds[camera] for camera in cameras],
            [self._job.sizes_px[camera] for camera in cameras],
            self._scale,
        )
        lenses = np.full((len(self._cameras), 4), np.nan)
        poses = np.full((len(self._cameras), 3, 4), np.nan)
        left = np.unique(bundle.cameras)
        numbers = np.array(cameras, np.int64)
        lenses[numbers[left]], poses[numbers[left]] = bundle.lenses[left], bundle.poses[left]
        seen = np.column_stack([bundle.seen, numbers[bundle.cameras], bundle.keypoints])
        return {"lenses": lenses, "poses": poses, "points": bundle.points, "seen": seen}


def main(folder: Path) -> None:
    job = Job(**json.loads((folder / JOB_NAME).read_text()))
    arrays: dict[str, Any] = Mapper(folder, job).run()
    np.savez(folder / RESULT_NAME, **arrays)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
