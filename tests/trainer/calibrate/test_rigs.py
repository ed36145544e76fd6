"""Rigs without pictures: similarities, the world, and whether a rig is told from a wrong one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from codec.arrays import Doubles
from codec.camera import Camera, look_at
from trainer.calibrate.mapping import is_borne_out, pooled
from trainer.calibrate.solution import (
    Rig,
    Similarity,
    Solution,
    align,
    angles_deg,
    centres,
    metres_of_unit,
    unseen_errors,
    world_of,
)
from trainer.calibrate.verdicts import judge, moved
from trainer.errors import CaptureError

WIDTH, HEIGHT, FOCAL = 640, 360, 500.0
NAMES = [f"cam{i}" for i in range(8)]
WIDTHS = [WIDTH] * len(NAMES)
MOMENTS = 6


def arc(count: int = len(NAMES)) -> Doubles:
    """(C, 3, 4) cameras 15 degrees apart that look at the origin."""
    angles = np.radians(15) * np.arange(count)
    places = 3 * np.column_stack([np.cos(angles), np.sin(angles), 0.1 * np.arange(count) % 0.4])
    up = np.array([0.0, 0.0, 1.0])
    return np.array([look_at(place, np.zeros(3), up)[:3] for place in places])


def turned(pose: Doubles, degrees: float, by: Doubles) -> Doubles:
    """A pose (3, 4) elsewhere."""
    rotation = Rotation.from_euler("y", degrees, degrees=True).as_matrix() @ pose[:, :3]
    return np.column_stack([rotation, -rotation @ (centres(pose[None])[0] + by)])


def test_similarities_are_found_though_some_cameras_are_elsewhere() -> None:
    true = Similarity(
        2.5, Rotation.from_rotvec([0.3, -1.0, 0.7]).as_matrix(), np.array([1, 2, -5.0])
    )
    one = arc()
    other = true.poses(one)
    np.testing.assert_allclose(true.points(centres(one)), centres(other), atol=1e-12)
    for i in (1, 4, 6):
        other[i] = turned(other[i], 30, np.array([3.0, -4.0, 2.0]))
    found = align(one, other)
    np.testing.assert_allclose(found.scale, true.scale, rtol=1e-9)
    np.testing.assert_allclose(found.rotation, true.rotation, atol=1e-9)
    np.testing.assert_allclose(found.offset, true.offset, atol=1e-8)
    away = angles_deg(found.poses(one)[:, :, :3], other[:, :, :3])
    assert (away[[1, 4, 6]] > 29).all()
    assert away[[0, 2, 3, 5, 7]].max() < 1e-4


def test_the_world_has_its_floor_level_and_its_origin_where_all_look() -> None:
    rng = np.random.default_rng(0)
    floor = np.column_stack([rng.uniform(-2, 2, (300, 2)), np.full(300, -1.2)])
    points = np.concatenate([floor, rng.uniform(-1, 1, (700, 3))])
    rolled = arc()
    rolled[:, :, :3] = Rotation.from_euler("z", 6, degrees=True).as_matrix() @ rolled[:, :, :3]
    rolled[:, :, 3] = np.einsum("cij,cj->ci", -rolled[:, :, :3], centres(arc()))
    tilt = Similarity(
        0.2, Rotation.from_rotvec([0.9, 0.4, -2.0]).as_matrix(), np.array([9.0, 8, 7])
    )
    poses = tilt.poses(rolled)
    cameras = [
        Camera(name, WIDTH, HEIGHT, FOCAL, FOCAL, 320, 180, np.vstack([pose, [0, 0, 0, 1]]))
        for name, pose in zip(NAMES, poses, strict=True)
    ]
    world, has_floor = world_of(cameras, tilt.points(points), None)
    assert has_floor
    heights = world.points(tilt.points(floor))[:, 2]
    assert np.ptp(heights) < 1e-6
    assert heights[0] < 0
    np.testing.assert_allclose(world.points(tilt.points(np.zeros(3))), 0, atol=1e-6)
    away = np.linalg.norm(centres(world.poses(poses)), axis=1)
    np.testing.assert_allclose(np.median(away), 3.0)
    _, from_points = world_of(cameras, tilt.points(points[300:]), None)
    assert not from_points
    metres = metres_of_unit(cameras, "cam0", "cam4", 3.0)  # 60 degrees on a radius of 3
    np.testing.assert_allclose(metres, 1 / 0.2, rtol=0.01)


def solution_of(first: Doubles, second: Doubles, whole: Doubles, filmed: Doubles) -> Solution:
    """What is solved as these poses of what cameras at `filmed` (2, C, 3, 4), of the two halves,
    saw: 60 points in each moment, to half a pixel."""
    rng = np.random.default_rng(0)
    keypoints = [np.zeros((0, 3)) for _ in NAMES]
    places = []
    for moment in range(MOMENTS):
        xyz = rng.uniform(-0.8, 0.8, (60, 3))
        places.append(xyz)
        for i, pose in enumerate(filmed[moment * 2 // MOMENTS]):
            local = xyz @ pose[:, :3].T + pose[:, 3]
            xy = FOCAL * local[:, :2] / local[:, 2:] + (WIDTH / 2, HEIGHT / 2)
            xy += rng.normal(0, 0.5, xy.shape)
            row = np.column_stack([xy, np.full(60, moment)])
            keypoints[i] = np.concatenate([keypoints[i], row])
    half = 60 * MOMENTS // 2
    pairs = [(i, j) for i in range(len(NAMES)) for j in range(i + 1, min(i + 4, len(NAMES)))]
    matches = {
        name: {pair: np.repeat(np.arange(start, start + half)[:, None], 2, 1) for pair in pairs}
        for name, start in (("first", 0), ("second", half))
    }
    lenses = np.tile([FOCAL, WIDTH / 2, HEIGHT / 2, 0.0], (len(NAMES), 1))
    rigs = {
        (name, "like"): Rig(lenses, poses, np.concatenate(places), np.zeros((0, 3), np.int64))
        for name, poses in (("first", first), ("second", second), ("whole", whole))
    }
    return Solution(keypoints, np.zeros((len(NAMES), MOMENTS)), matches, rigs)


def test_a_right_rig_is_borne_out_by_what_it_has_not_seen() -> None:
    true = arc()
    solution = solution_of(true, true, true, np.array([true, true]))
    errors = [np.median(each) for each in unseen_errors(solution, "like", WIDTHS)]
    assert max(errors) < 2.0
    assert not judge(solution, NAMES, WIDTHS)[1]


def with_third(pose: Doubles | float) -> Doubles:
    """The arc with another pose for cam3."""
    poses = arc()
    poses[3] = pose
    return poses


ELSEWHERE = with_third(turned(arc()[3], 8, np.array([0.0, 0.2, 0.3])))
MISSING, TWIN = with_third(np.nan), with_third(arc()[2])


@pytest.mark.parametrize(
    ("first", "second", "filmed_first", "filmed_second", "says"),
    [
        (arc(), ELSEWHERE, arc(), ELSEWHERE, "by the two halves of the take"),
        (ELSEWHERE, ELSEWHERE, arc(), arc(), "misses points of unseen moments"),
        (arc(), MISSING, arc(), arc(), "shares too few points"),
        (TWIN, TWIN, TWIN, TWIN, "stands where cam2 does"),
    ],
    ids=["moved", "wrong", "missing", "twin"],
)
def test_a_wrong_camera_is_named_with_the_reason(
    first: Doubles, second: Doubles, filmed_first: Doubles, filmed_second: Doubles, says: str
) -> None:
    solution = solution_of(first, second, first, np.array([filmed_first, filmed_second]))
    _, wrong = judge(solution, NAMES, WIDTHS)
    assert list(wrong) == [3]
    assert says in wrong[3]


def test_what_stands_still_is_one_keypoint_and_does_not_bear_out_matches() -> None:
    still = np.array([[10.4, 20.6], [300.2, 7.3]])
    found = [[*xy, moment] for moment in range(6) for xy in (*still, [50.5 + 9 * moment, 80.5])]
    keypoints, numbers, moves = pooled(np.array(found))
    assert moves.sum() == 6
    np.testing.assert_allclose(keypoints[~moves], np.column_stack([still, [0, 0]]))
    np.testing.assert_allclose(keypoints[numbers, :2], np.array(found)[:, :2])
    floor, walker, none = np.zeros(200, bool), np.ones(30, bool), np.zeros(0, bool)
    both = np.concatenate([floor, walker])
    assert is_borne_out(both, np.concatenate([floor[:60], walker[:20]]))
    assert not is_borne_out(both, np.concatenate([floor[:160], walker[:4]]))
    assert is_borne_out(floor, floor[:60])
    assert not is_borne_out(floor, none)


def unplaced(solution: Solution, features: dict[int, int]) -> Solution:
    """The solution where cameras show only so many features in a moment, which match
    no others, and are in no rig."""
    keypoints = [
        each[np.arange(len(each)) % 60 < features.get(i, 60)]
        for i, each in enumerate(solution.keypoints)
    ]
    kept = {
        name: {p: m for p, m in found.items() if not features.keys() & p}
        for name, found in solution.matches.items()
    }
    missing = np.isin(np.arange(len(NAMES)), list(features))[:, None, None]
    rigs = {
        key: replace(rig, poses=np.where(missing, np.nan, rig.poses))
        for key, rig in solution.rigs.items()
    }
    return replace(solution, keypoints=keypoints, matches=kept, rigs=rigs)


@pytest.mark.parametrize(
    ("features", "says"),
    [
        ({3: 60}, "another room"),
        ({3: 0}, "shows nothing to recognise (0 features): blank"),
        ({2: 9, 5: 12}, "out of focus"),
    ],
    ids=["another room", "blank wall", "two of eight out of focus"],
)
def test_cameras_that_are_in_no_rig_are_named(features: dict[int, int], says: str) -> None:
    true = arc()
    solution = unplaced(solution_of(true, true, true, np.array([true, true])), features)
    _, wrong = judge(solution, NAMES, WIDTHS)
    assert wrong.keys() == features.keys()
    assert all(says in reason for reason in wrong.values())
    with pytest.raises(CaptureError, match="no rig was found"):
        judge(unplaced(solution, dict.fromkeys((3, 4, 5, 6, 7), 60)), NAMES, WIDTHS)


def test_a_rig_whose_halves_disagree_is_refused() -> None:
    true, rng = arc(), np.random.default_rng(1)
    other = np.array([turned(pose, 6, rng.normal(0, 0.4, 3)) for pose in true])
    solution = solution_of(true, other, true, np.array([true, true]))
    with pytest.raises(CaptureError, match="is not certain"):
        judge(solution, NAMES, WIDTHS)
    with pytest.raises(CaptureError, match="no rig was found"):
        judge(replace(solution, rigs={}), NAMES, WIDTHS)


def test_cameras_that_move_once_or_all_the_time_are_told_apart() -> None:
    still, shaking = np.full(12, 0.3), 4 + 6 * np.random.default_rng(0).random(12)
    once = np.where(np.arange(12) < 8, 0.2, 9.0)
    unknown = np.full(12, np.nan)
    found = moved(np.array([still, once, shaking, unknown]), [640] * 4)
    assert found[0] == ""
    assert "moved during the take, after 67% of it, by 9 px" in found[1]
    assert "hand-held" in found[2]
    assert found[3] == ""
