"""manifest.json: valid ones round-trip, invalid ones raise the reason."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from codec.camera import MAX_NAME_CHARS, Camera
from codec.errors import CodecError, CorruptError, InvalidError
from codec.lattice.lattice import Lattice
from codec.slots.slotlayout import SlotLayout
from codec.stream.manifest import MAX_MANIFEST_BYTES, Manifest
from tests.support.hostile import refused, survives, truncations


def camera(name: str) -> Camera:
    return Camera(name, 640, 360, 500.0, 510.0, 320.0, 180.0, np.eye(4))


LATTICE = Lattice(0.01, 0.125, 1 / 60, 0.056, 41)
MANIFEST = Manifest(
    fps=29.97,
    swin_size=5,
    slots=(50, 50, 100),
    lattice=(LATTICE,) * 3,
    segment_frames=30,
    sh_degree=1,
    antialias=False,
    near_m=0.1,
    bounds=((-1.0, -2.0, -3.0), (1.0, 2.0, 3.0)),
    cameras=(camera("left"), camera("rechts ü")),
    default_camera="left",
    live=True,
    poster="poster.jpg",
    title="Ball & Bälle",
)
VALUE: dict[str, Any] = json.loads(MANIFEST.to_json())


def test_round_trip() -> None:
    found = Manifest.from_json(MANIFEST.to_json())
    assert found.to_json() == MANIFEST.to_json()
    assert replace(found, cameras=MANIFEST.cameras) == MANIFEST
    assert (found.camera("rechts ü").w2c == np.eye(4)).all()
    assert found.camera().name == "left"
    refused(InvalidError, "no camera is called 'x'; there are left, rechts", found.camera, "x")
    unknown = {"audio": [1], "layers": "shares", "profile": 7}
    assert Manifest.from_json(json.dumps(VALUE | unknown).encode()).title == MANIFEST.title
    for poster in (None, "", "https://cdn/poster.png", "ü" * 127 + "x"):
        assert Manifest.from_json(replace(MANIFEST, poster=poster).to_json()).poster == poster


def test_near_planes_of_cameras() -> None:
    """Each camera has its own near plane; away from it the common one returns, without a step."""
    left = MANIFEST.camera("left")

    def moved(x_m: float) -> Camera:
        w2c = np.eye(4)
        w2c[0, 3] = -x_m
        return replace(left, w2c=w2c)

    assert "camera_near_m" not in VALUE
    assert MANIFEST.near_of(left) == MANIFEST.near_of(moved(3)) == MANIFEST.least_near_m == 0.1
    cameras = (left, replace(moved(10), name="right"))
    manifest = replace(MANIFEST, cameras=cameras, near_m=0.5, camera_near_m=(0.2, 0.9))
    found = Manifest.from_json(manifest.to_json())
    assert found.camera_near_m == (0.2, 0.9)
    assert [found.near_of(camera.scaled(0.5)) for camera in cameras] == [0.2, 0.9]
    steps = np.linspace(-1, 11, 1201)
    depths = np.array([found.near_of(moved(x)) for x in steps])
    assert depths[np.abs(steps - 5) < 4.5] == pytest.approx(0.5)
    assert np.abs(np.diff(depths)).max() <= 0.0101
    assert found.least_near_m == depths.min() == 0.2
    assert depths.max() == 0.9


def test_what_follows_from_it() -> None:
    assert (MANIFEST.slice_size, MANIFEST.num_gs, MANIFEST.layers) == (200, 1000, (0.25, 0.25, 0.5))
    assert (MANIFEST.num_layers, MANIFEST.first_birth) == (3, -4)
    assert MANIFEST.slot_layout == SlotLayout(5, (50, 50, 100), 1, (LATTICE,) * 3, 30)
    assert MANIFEST.object_path(12, 2) == "segments/12/2"
    assert [MANIFEST.segment_of(birth) for birth in (-4, 0, 29, 30, 61)] == [0, 0, 0, 1, 2]
    assert MANIFEST.object_path(12, "keyframe-2") == "segments/12/keyframe-2"
    assert MANIFEST.births(0, 30) == range(30)
    assert MANIFEST.births(2, 7) == range(60, 67)


@pytest.mark.parametrize(
    "change",
    [
        {"fps": 1e-320},
        {"fps": float("inf")},
        {"fps": float("nan")},
        {"slots": ()},
        {"slots": (50, 150)},
        {"slots": (1 << 20, 1, 1), "swin_size": 1, "segment_frames": 1},
        {"slots": (1 << 18,) * 3, "swin_size": 22, "segment_frames": 1},
        {"slots": (1 << 18,) * 3, "swin_size": 1, "segment_frames": 342},
        {"slots": (1,) * 17, "lattice": (LATTICE,) * 17},
        {"near_m": float("inf")},
        {"camera_near_m": (0.1,)},
        {"camera_near_m": (0.1, 0.0)},
        {"camera_near_m": (0.1, float("nan"))},
        {"bounds": ((0.0, 0.0, float("nan")), (1.0, 1.0, 1.0))},
        {"cameras": tuple(camera(str(n)) for n in range(257)), "default_camera": "0"},
        {"object_url": "{segment}/{layer}/{__class__}"},
        {"poster": "a\0b"},
        {"poster": "a\nb"},
        {"poster": "ü" * 128},
        {"poster": "\ud800"},
    ],
)
def test_values_that_break_a_rule(change: dict[str, Any]) -> None:
    """conformance/hostile.json has more such values."""
    refused(InvalidError, r"^manifest: ", replace, MANIFEST, **change)


JUNK: list[Any] = [None, True, 1, -1, 0.5, 1e400, 10**400, "", "x", [], [1, 2], [[]], {}, {"a": 1}]


@pytest.mark.parametrize("key", sorted(VALUE))
def test_junk_under_any_key_and_a_missing_key(key: str) -> None:
    for junk in JUNK:
        survives(Manifest.from_json, json.dumps(VALUE | {key: junk}).encode())
    without = {k: v for k, v in VALUE.items() if k != key}
    refused(CodecError, key, Manifest.from_json, json.dumps(without).encode())


def test_a_name_of_a_camera_is_kept_whole_or_refused() -> None:
    longest = "ü" * MAX_NAME_CHARS
    manifest = replace(
        MANIFEST, cameras=(camera(longest), camera(longest[:-1])), default_camera=longest
    )
    assert Manifest.from_json(manifest.to_json()).camera().name == longest
    refused(InvalidError, "a name of 2001 characters, at most 2000", camera, longest + "x")
    cameras = [VALUE["cameras"][0] | {"name": longest + "x"}, VALUE["cameras"][0]]
    with pytest.raises(CorruptError, match="a name of 2001 characters, at most 2000"):
        Manifest.from_json(json.dumps(VALUE | {"cameras": cameras}).encode())


def test_a_live_manifest_can_still_be_finished(monkeypatch: pytest.MonkeyPatch) -> None:
    finished = replace(MANIFEST, live=False)
    size = len(finished.to_json())
    monkeypatch.setattr("codec.stream.manifest.MAX_MANIFEST_BYTES", size)
    assert len(MANIFEST.to_json()) == size - 1
    monkeypatch.setattr("codec.stream.manifest.MAX_MANIFEST_BYTES", size - 1)
    for manifest in (MANIFEST, finished):
        refused(InvalidError, "shorten the names", manifest.to_json)


def test_every_truncation_is_refused() -> None:
    data = MANIFEST.to_json().rstrip()
    for cut in [*list(truncations(data))[::7], b" " * (MAX_MANIFEST_BYTES + 1)]:
        refused(CorruptError, "manifest", Manifest.from_json, cut)


HALF = "\ud800"
WRONG_CAMERAS: list[dict[str, Any]] = [
    *({"name": name} for name in (7, ["front"], HALF)),
    *({"width_px": "64"}, {"width_px": 64.0}, {"height_px": True}, {"fx_px": "50"}),
    *({"cx_px": None}, {"fy_px": 10**400}, {"w2c": ["1"] * 16}, {"w2c": [[1.0] * 4] * 4}),
    *({"w2c": "1" * 16}, {"w2c": [10**400] * 16}),
]


WRONG_CAPTIONS: list[Any] = [
    *({}, [{"language": "en"}], [{"language": "../en", "label": "x"}]),
    *([{"language": "en", "label": label}] for label in ("", "a\nb", "a" * 81)),
    [{"language": language, "label": "a"} for language in ("en", "EN")],
    [{"language": f"l{n}", "label": "a"} for n in range(17)],
]


@pytest.mark.parametrize(
    "change",
    [
        *({"cameras": [VALUE["cameras"][0] | change]} for change in WRONG_CAMERAS),
        *({"poster": name} for name in ("a\0b", "x" * 300, "\x7f", "ü" * 128, HALF)),
        *({"title": HALF}, {"object_url": HALF + "{segment}{layer}"}),
        *({"captions": value} for value in WRONG_CAPTIONS),
    ],
)
def test_what_a_manifest_cannot_say(change: dict[str, Any]) -> None:
    """A text that is not Unicode could not be written again."""
    with pytest.raises(CorruptError, match=r"camera|poster .* is longer|surrogate|caption|label"):
        Manifest.from_json(json.dumps(VALUE | change).encode())


@pytest.mark.parametrize("key", ["name", "w2c"])
def test_lists_in_lists_as_deep_as_json_goes(key: str) -> None:
    """The parser accepts this depth, but it exhausts the stack of code that prints the value."""
    for depth in range(800, 1000):
        deep = "[" * depth + "]" * depth
        camera = json.dumps(VALUE["cameras"][0] | {key: 7}).replace('": 7', f'": {deep}')
        data = json.dumps(VALUE | {"cameras": [1]}).replace("[1]", f"[{camera}]").encode()
        assert not survives(Manifest.from_json, data)
