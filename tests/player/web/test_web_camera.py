"""The camera of the browser over time: bounds, inertia, flights, fly mode, turned phones."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest

from codec.pose import look_at
from codec.sequence.importing import facing_camera
from codec.stream.manifest import Manifest
from tests.support.hosted_streams import ring_of_cameras, small_manifest
from tests.support.web.nodeprocess import NODE, Json, NodeProcess, running_script

PICTURES_PER_S = 60
UP = np.array([0.0, -1.0, 0.0])
SCENE = np.array([0.0, 0.0, 4.0])
"""The point at which the rings look."""

Step = Sequence[object]
Move = Callable[..., list[Json]]


@pytest.fixture(scope="module")
def node() -> Iterator[NodeProcess]:
    if NODE is None:
        pytest.skip("needs Node.js: apt-get install nodejs")
    with running_script("camera.mjs") as running:
        yield running


@pytest.fixture
def move(node: NodeProcess) -> Move:
    """A function that returns the state of the camera after each step."""

    def moving(*steps: Step, manifest: Manifest | None = None, reduced: bool = False) -> list[Json]:
        text = (manifest or small_manifest()).to_json().hex()
        question = {"manifest": text, "steps": steps, "reduced": reduced}
        found: list[Json] = node.answer("moved", question)["value"]
        return found

    return moving


def rig(*cameras: tuple[np.ndarray, np.ndarray]) -> Manifest:
    """A manifest with cameras, given by place and target."""
    made = tuple(
        replace(ring_of_cameras(1)[0], name=f"c{n}", w2c=look_at(place, target, UP))
        for n, (place, target) in enumerate(cameras)
    )
    return small_manifest(cameras=made)


def dome() -> Manifest:
    rng = np.random.default_rng(0)
    turns, tilts = rng.uniform(0, 2 * math.pi, 40), rng.uniform(0, 1.4, 40)
    level = np.cos(tilts)
    ways = np.stack([level * np.sin(turns), -np.sin(tilts), level * np.cos(turns)], 1)
    return rig(*((SCENE + 3 * way, SCENE) for way in ways))


def wall() -> Manifest:
    """Cameras in a plane that look the same way."""
    places = [np.array([x / 4, y / 4, 0.0]) for x in range(-2, 3) for y in range(-1, 2)]
    return rig(*((place, place + np.array([0.0, 0, 1])) for place in places))


def outward() -> Manifest:
    ways = [np.array([math.sin(a), 0.1 * n, math.cos(a)]) for n, a in enumerate(range(6))]
    return rig(*((SCENE, SCENE + way) for way in ways))


def model() -> Manifest:
    camera = facing_camera(np.array([-2.0, -2, 2]), np.array([2.0, 2, 6]))
    return small_manifest(cameras=(camera,), default_camera=camera.name)


def on_its_side() -> Manifest:
    turn = np.array([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    made = small_manifest()
    return replace(made, cameras=tuple(replace(c, w2c=turn @ c.w2c) for c in made.cameras))


RIGS = [small_manifest, dome, wall, outward, model, on_its_side]


def arc(found: Json) -> float:
    """Angle by which the camera has turned about the vertical, radians."""
    x, _, z = found["pose"]["forward"]
    return math.atan2(x, z)


def size(excess: Json) -> float:
    parts = [excess["logDistance"], excess["pitchRad"], excess["headingRad"], *excess["offM"]]
    return float(np.linalg.norm(np.array(parts, float)))  # a NaN arrives as None


def after(found: Json, at_ms: int, until_ms: int, per_s: int = PICTURES_PER_S) -> Step:
    return ("run", at_ms, until_ms, per_s)


@pytest.mark.parametrize("made", RIGS, ids=lambda made: made.__name__)
def test_all_cameras_of_a_rig_are_within_its_bounds(node: NodeProcess, made: object) -> None:
    manifest = made()  # type: ignore[operator]
    found = node.answer("excesses", {"manifest": manifest.to_json().hex()})["value"]
    for excess in found["around"]:
        assert size(excess) < 1e-9
    bounds = found["bounds"]
    for lower, upper in (bounds["distanceM"], bounds["pitchRad"], bounds["heightM"]):
        assert lower < upper
    assert bounds["focusM"] > 0


def test_a_rig_of_one_side_ends_at_its_sides(node: NodeProcess) -> None:
    def heading(manifest: Manifest) -> Json:
        found = node.answer("excesses", {"manifest": manifest.to_json().hex()})["value"]
        return found["bounds"]["heading"]

    assert heading(small_manifest()) is None
    assert heading(model()) is None
    assert heading(wall())["halfRad"] == pytest.approx(math.radians(40))


@pytest.mark.parametrize("made", RIGS, ids=lambda made: made.__name__)
@pytest.mark.parametrize(
    "away",
    [
        [("approach", -60)],
        [("approach", 60)],
        [("turn", 2.5, -1.5)],
        [("turn", -2.9, 1.5)],
        [("dragPan", 900, -700, 500, 0)] * 9,
        [("dragPan", 500, 300, 200, 0), ("turn", 1, -2), ("approach", -20)],
        [("fly", True), ("dragPan", 900, 9000, 500, 0), ("turn", 0.4, 0.3)],
        [("text", "1,2,30,-7,9")],
        [("text", "900,-80,7,0.5,0.5,-0.5,0.5,20,1000,-3")],
    ],
)
def test_what_is_beyond_the_bounds_springs_back(move: Move, made: object, away: list[Step]) -> None:
    """The camera comes nearer with every picture, and rests within the bounds. A link may have put
    it so far away that turns alone move it by kilometres."""
    steps = [("run", n * 16, (n + 1) * 16, 62.5) for n in range(250)]
    found = move(("grab",), *away, ("release", "turn", 1e6), *steps, manifest=made())  # type: ignore[operator]
    sizes = [size(each["excess"]) for each in found[1 + len(away) :]]
    assert all(np.isfinite(each["pose"]["position"]).all() for each in found)
    assert sizes[-1] < 1e-3
    assert found[-1]["answer"] is False
    if made is not on_its_side and sizes[0] < 100:
        assert np.diff(sizes).max() < 1e-3


def test_a_drag_that_was_let_go_runs_out(move: Move) -> None:
    def drag(rest_ms: int) -> list[Step]:
        moves = [("dragTurn", 4, 0, at) for at in range(0, 160, 16)]
        return [("grab",), *moves, ("release", "turn", 144 + rest_ms)]

    ends = {}
    for per_s in (30, 60, 144):
        *_, let_go, end = move(*drag(0), ("run", 144, 3144, per_s))
        # 4 pixels in 16 ms are 1.25 rad/s, and an e-folding of 0.25 s makes it 0.3125 rad.
        assert let_go["isMoving"]
        assert not end["isMoving"]
        ends[per_s] = arc(end) - arc(let_go)
    assert ends[60] == pytest.approx(0.3125, rel=0.15)
    assert ends[30] == pytest.approx(ends[144], rel=0.02)
    *_, rested = move(*drag(300))
    assert not rested["isMoving"]
    *_, reduced = move(*drag(0), reduced=True)
    assert not reduced["isMoving"]
    *_, before, caught, end = move(*drag(0), ("grab",), ("run", 200, 1200, 60))
    assert caught["pose"] == before["pose"] == end["pose"]


def test_a_drag_beyond_the_bounds_is_harder(move: Move) -> None:
    found = move(("grab",), *[("turn", 0, -0.1)] * 14)
    steps = np.abs(np.diff([each["excess"]["pitchRad"] for each in found]))
    beyond = steps[steps > 1e-9]
    assert (np.diff(beyond[1:]) < 0).all()
    assert beyond[-1] < 0.03


def position(found: Json) -> np.ndarray:
    return np.array(found["pose"]["position"])


def test_flights_to_the_cameras_of_the_rig(move: Move) -> None:
    manifest = small_manifest()
    halfway, there, back, home = move(
        ("flyToCamera", 1),
        ("run", 0, 2000, 60),
        ("key", "["),
        ("run", 3000, 5000, 60),
    )
    assert halfway["isMoving"]
    assert halfway["pose"]["position"] == pytest.approx([0, 0, 0])
    np.testing.assert_allclose(position(there), manifest.cameras[1].position, atol=1e-9)
    assert not there["isMoving"]
    assert (there["cameraIndex"], back["cameraIndex"]) == (1, 0)
    assert home["text"] == "0,0,1,0,0"
    (last,) = move(("key", "["), manifest=manifest)
    assert last["cameraIndex"] == 3
    (at_once,) = move(("key", "]"), reduced=True)
    np.testing.assert_allclose(position(at_once), manifest.cameras[1].position, atol=1e-9)
    # A flight along the ring keeps its distance, and turns without stops.
    way = move(("flyToCamera", 1), *[("run", n * 20, n * 20 + 20, 50) for n in range(45)])[1:]
    distances = [np.linalg.norm(position(each) - SCENE) for each in way]
    np.testing.assert_allclose(distances, 4, atol=1e-6)
    turns = np.abs(np.diff(np.unwrap([arc(each) for each in way])))
    assert turns.max() < 0.1
    assert sum(turns) == pytest.approx(math.pi / 2, abs=0.01)


@pytest.mark.parametrize(
    "gesture", [("grab",), ("turn", 0.1, 0), ("approach", 1), ("text", "0,0,1,0,0")]
)
def test_any_gesture_ends_a_flight(move: Move, gesture: Step) -> None:
    found = move(("flyToCamera", 1), ("run", 0, 400, 60), gesture, ("run", 400, 2000, 60))
    *_, before, end = found
    assert not end["isMoving"]
    np.testing.assert_allclose(position(end), position(before), atol=1e-9)


def test_the_way_between_two_poses(node: NodeProcess) -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        places = []
        for _ in range(2):
            eye, target = rng.normal(0, 3, (2, 3))
            rows = look_at(eye, target, rng.normal(size=3))[:3, :3].tolist()
            pose = dict(zip(("right", "down", "forward"), rows, strict=True))
            centre = rng.normal(0, 3, 3).tolist()
            places.append({"pose": {"position": eye.tolist(), **pose}, "centre": centre})
        shares = [0, 0.01, 0.3, 0.5, 0.99, 1]
        question = {"from": places[0], "to": places[1], "shares": shares}
        way = node.answer("between", question)["value"]
        assert way[0] == places[0]
        assert way[-1] == places[1]
        rotations = [
            np.array([each["pose"][axis] for axis in ("right", "down", "forward")]) for each in way
        ]
        for rotation in rotations:
            np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)

        def angle(a: np.ndarray, b: np.ndarray) -> float:
            return math.acos(min(1, max(-1, (np.trace(a @ b.T) - 1) / 2)))

        whole = angle(rotations[0], rotations[-1])
        for share, rotation in zip(shares, rotations, strict=True):
            assert angle(rotations[0], rotation) == pytest.approx(share * whole, abs=1e-6)
        assert position(way[1]) == pytest.approx(position(way[0]), abs=1.5)


def test_a_focus_turns_around_what_was_tapped(move: Move) -> None:
    point = [0.6, 0.3, 4.4]
    _, there, turned = move(
        ("focusOn", point), ("run", 0, 2000, 60), ("turn", 0.4, 0.1), manifest=dome()
    )
    for found in (there, turned):
        assert found["centre"] == pytest.approx(point)
        towards = np.array(point) - position(found)
        ahead = towards / np.linalg.norm(towards)
        assert found["pose"]["forward"] == pytest.approx(list(ahead), abs=1e-6)
    # The camera looks at points far behind the scene, but turns around a nearer centre.
    _, far = move(("focusOn", [1, 1, 90]), ("run", 0, 2000, 60))
    assert np.linalg.norm(np.array(far["centre"]) - SCENE) <= 4 + 1e-6
    assert size(far["excess"]) < 1e-3


def test_fly_mode(move: Move) -> None:
    start, *_, flown, rest, turned, still = move(
        ("key", "g"),
        ("key", "w"),
        ("run", 0, 1000, 60),
        ("lift", "w"),
        ("run", 1000, 2000, 60),
        ("turn", 0.5, 0.1),
        ("key", "g"),
    )
    assert start["isFlying"]
    assert flown["isMoving"]
    # Half of the rig's distance per second, minus the time to accelerate, plus the way to stop.
    assert position(rest)[2] == pytest.approx(2, rel=0.1)
    assert not rest["isMoving"]
    np.testing.assert_allclose(position(turned), position(rest), atol=1e-9)
    np.testing.assert_allclose(position(still), position(rest), atol=1e-9)
    assert not still["isFlying"]
    assert still["distanceM"] > 0
    pushed, *_, end = move(
        ("key", "shift+d"), ("run", 0, 200, 60), ("lift", "Shift"), after({}, 200, 900)
    )
    assert not pushed["isFlying"]
    assert position(end)[0] > 0.2
    assert not end["isMoving"]


def test_links_hold_every_view(move: Move) -> None:
    manifest = dome()
    for steps in (
        [("turn", 0.3, -0.2), ("approach", 2), ("dragPan", 30, 20, 500, 0)],
        [("flyToCamera", 3), ("run", 0, 300, 60)],
        [("flyToCamera", 3), ("run", 0, 900, 60), ("turn", 0.3, 0.1)],
        [("key", "g"), ("key", "w"), ("run", 0, 300, 60), ("turn", 0.3, 0.2)],
    ):
        *_, there = move(*steps, manifest=manifest)
        (again,) = move(("text", there["text"]), manifest=manifest)
        np.testing.assert_allclose(position(again), position(there), atol=2e-3)
        assert again["pose"]["forward"] == pytest.approx(there["pose"]["forward"], abs=1e-3)
    for text in ("", "1,2", "a,b,c,d,e", "1,2,3,4,1e300", "0,0,0,0,0,0,0,0,0,0"):
        (left,) = move(("text", text), manifest=manifest)
        assert left["text"] == "0,0,1,0,0"


def test_a_phone_that_is_turned(node: NodeProcess) -> None:
    def turns(*angles: tuple[float, float, float]) -> Json:
        return node.answer("deviceTurns", {"angles": angles})["value"]

    upright = turns((0, 90, 0), (30, 90, 0))
    assert upright["turns"][0]["pitchRad"] == pytest.approx(0)
    assert upright["between"] == pytest.approx([math.radians(30), 0])
    assert turns((350, 90, 0), (10, 70, 0))["between"] == pytest.approx(
        [math.radians(20), -math.radians(20)]
    )
    assert turns((0, 0, 0))["turns"][0]["headingRad"] is None
    # Held sideways, the same turn has other angles; here the top of the phone points left.
    assert turns((90, 0, -90), (120, 0, -90))["between"] == pytest.approx([math.radians(30), 0])


def test_double_taps(node: NodeProcess) -> None:
    def doubles(*touches: tuple[float, ...]) -> list[bool]:
        found: list[bool] = node.answer("doubleTaps", {"touches": touches})["value"]
        return found

    first, second = (0, 80, 100, 100, 1), (250, 330, 110, 95, 1)
    assert doubles(first, second, (500, 580, 110, 95, 1)) == [False, True, False]
    assert doubles(first, (250, 330, 200, 100, 1)) == [False, False]  # elsewhere
    assert doubles(first, (900, 980, 100, 100, 1)) == [False, False]  # too late
    assert doubles(first, (250, 900, 100, 100, 1)) == [False, False]  # a long press
    assert doubles(first, (250, 330, 110, 95, 2)) == [False, False]  # the second of two fingers
