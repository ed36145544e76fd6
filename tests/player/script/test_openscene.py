"""A stream in a script: exact frames in any order, from any source, and no leftovers."""

from __future__ import annotations

import shutil
import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

import player
from codec.arrays import Floats
from codec.errors import InvalidError, SwingsError
from codec.splats import Splats
from codec.stream import StreamReader, StreamWriter
from codec.tools.static import export_static
from player import Scene
from player.network.fetch import Fetcher, FetchError, RetryConfig
from player.render.cpu import CpuRenderer, render_splats
from player.source.opener import SourceConfig
from tests.support.commands import ROOT
from tests.support.drawn import same_splats
from tests.support.hosted_streams import (
    SEGMENT_FRAMES,
    SLICE_SIZE,
    SWIN_SIZE,
    ServerProcess,
    random_slice,
    served,
    small_manifest,
    static_host,
    write_stream,
)
from tests.support.slots.slot_streams import write_busy_stream, write_slot_stream
from tests.support.slots.updates import small_layout

HASTY = SourceConfig(RetryConfig(0.0))

NUM_FRAMES = 33
STREAMS = ("whole", "busy", "patternless")
"""Streams of whole slices, and of slots that last."""


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("library")
    write_stream(root / "whole", NUM_FRAMES)
    write_busy_stream(root / "busy", NUM_FRAMES, small_layout(4, (60, 60), 0, 7))
    write_slot_stream(root / "patternless", NUM_FRAMES, small_layout(5, (9, 7), 0, 6))
    return root


@pytest.fixture(scope="module")
def expected(library: Path) -> dict[tuple[str, int, int], Floats]:
    """Pictures from the second camera by stream, layers and frame, each from a reader of its
    own."""
    pictures = {}
    for name in STREAMS:
        for layers in (1, 2):
            for frame in range(NUM_FRAMES):
                reader = StreamReader(library / name)
                splats, near_m = reader.active_splats(frame, layers), reader.manifest.near_m
                picture = render_splats(splats, reader.manifest.camera("c1"), near_m)
                pictures[name, layers, frame] = picture
    return pictures


def shows_the_same(found: Splats, wanted: Splats) -> bool:
    """Whether both have the same visible Gaussians, in any order."""
    found, wanted = (one.take(np.flatnonzero(one.opacities > 1e-3)) for one in (found, wanted))
    attributes = [
        np.column_stack([one.means, one.log_scales, one.opacities, one.sh.reshape(len(one), -1)])
        for one in (found, wanted)
    ]
    away = cdist(*attributes)
    return len(found) == len(wanted) and bool(away[linear_sum_assignment(away)].max() < 0.01)


@pytest.mark.parametrize("name", STREAMS)
def test_between_two_frames_it_comes_from_one_and_goes_to_the_other(
    library: Path, expected: dict[tuple[str, int, int], Floats], name: str
) -> None:
    with Scene.open(library / name, layers=2, renderer="cpu") as scene:
        for frame in (14, 0, NUM_FRAMES - 2):
            assert shows_the_same(scene.splats(frame + 1e-5), scene.splats(frame))
            assert shows_the_same(scene.splats(frame + 1 - 1e-5), scene.splats(frame + 1))
            middle = scene.render(frame + 0.5, "c1")
            assert np.array_equal(middle, scene.render(frame + 0.5, "c1"))
            assert len(scene.splats(frame + 0.5)) >= len(scene.splats(frame + 1))
            clear = scene.render(frame + 0.5, "c1", background=None)
            assert np.allclose(clear[..., :3] * clear[..., 3:], middle, atol=1e-4)
            covered = ~np.isnan(scene.depth(frame + 0.5, "c1"))
            assert covered.any()
            assert (clear[..., 3][covered] > 0.45).all()
            assert np.array_equal(scene.render(float(frame), "c1"), expected[name, 2, frame])
        assert repr(scene).endswith(
            f"{name}: {NUM_FRAMES} frames at {scene.fps:g} a second, 2 layers>"
        )
        assert "Scene" in dir(player)
        for wrong in (NUM_FRAMES - 0.5, -0.5, float("nan")):
            with pytest.raises(InvalidError, match="there is no frame"):
                scene.splats(wrong)


def test_between_two_frames_the_near_plane_is_the_cameras(library: Path, tmp_path: Path) -> None:
    path = tmp_path / "near"
    shutil.copytree(library / "busy", path)
    manifest = StreamReader(path).manifest
    planes_m = tuple(4.0 if camera.name == "c1" else 0.5 for camera in manifest.cameras)
    (path / "manifest.json").write_bytes(replace(manifest, camera_near_m=planes_m).to_json())
    with Scene.open(path, renderer="cpu") as scene, Scene.open(library / "busy") as other:
        frame = scene.render(14, "c1")
        assert np.abs(scene.render(14 + 1e-5, "c1") - frame).mean() < 5e-3
        assert np.abs(other.render(14 + 1e-5, "c1") - frame).mean() > 0.02


@pytest.mark.parametrize("name", STREAMS)
@settings(max_examples=25, deadline=None)
@given(
    walk=st.lists(st.tuples(st.integers(0, NUM_FRAMES - 1), st.booleans()), max_size=12),
    layers=st.sampled_from((1, 2)),
)
def test_any_walk_through_the_frames_is_exact(
    library: Path,
    expected: dict[tuple[str, int, int], Floats],
    name: str,
    walk: list[tuple[int, bool]],
    layers: int,
) -> None:
    reader = StreamReader(library / name)
    with Scene.open(library / name, layers=layers, renderer="cpu") as scene:
        for frame, drawn in walk:
            if drawn:
                picture = scene.render(frame, "c1")
                np.testing.assert_array_equal(picture, expected[name, layers, frame])
            else:
                assert same_splats(scene.splats(frame), reader.active_splats(frame, layers))


def test_every_place_gives_the_same_and_leaves_no_thread(
    library: Path, server: ServerProcess, tmp_path: Path
) -> None:
    reader, before = StreamReader(library / "busy"), set(threading.enumerate())
    export_static(library / "busy", tmp_path / "static")
    with static_host(tmp_path) as export, static_host(library) as host:
        hosts = set(threading.enumerate()) - before
        for source in (
            f"{host}/busy/manifest.json",
            f"{server.url}/watch/busy",
            f"{server.url}/v1/streams/busy",
            f"{export}/static",
        ):
            with Scene.open(source, renderer="cpu") as scene:
                assert scene.num_frames == NUM_FRAMES
                for frame in (20, 3, 4):
                    assert same_splats(scene.splats(frame), reader.active_splats(frame, 2))
            assert set(threading.enumerate()) == before | hosts


def test_objects_may_lie_where_the_manifest_says(tmp_path: Path) -> None:
    stream = write_stream(tmp_path / "s", 13)
    manifest = StreamReader(stream).manifest
    splats = StreamReader(stream).active_splats(9, 3)
    elsewhere = replace(manifest, object_url="https://cdn.example/{layer}/{segment}")
    (stream / "manifest.json").write_bytes(elsewhere.to_json())
    with served(tmp_path) as server, Scene.open(f"{server.url}/watch/s") as scene:
        assert same_splats(scene.splats(9), splats)  # a server has the objects itself
    (tmp_path / "blobs").mkdir()
    for path in sorted((stream / "segments").glob("*/*")):
        path.rename(tmp_path / "blobs" / f"l{path.name}-s{path.parent.name}")
    elsewhere = replace(manifest, object_url="../blobs/l{layer}-s{segment}")
    (stream / "manifest.json").write_bytes(elsewhere.to_json())
    with static_host(tmp_path) as host, Scene.open(f"{host}/s") as scene:
        assert same_splats(scene.splats(9), splats)


def test_a_camera_by_name_by_value_and_in_another_size(library: Path) -> None:
    reader = StreamReader(library / "whole")
    splats, manifest = reader.active_splats(5, 3), reader.manifest
    moved, fitted = replace(manifest.camera("c2"), fx_px=80.0), manifest.camera("c3").fitted(50, 70)
    with Scene.open(library / "whole", renderer="cpu") as scene:
        assert scene.fps == manifest.fps
        assert [camera.name for camera in scene.cameras] == ["c0", "c1", "c2", "c3"]
        for found, camera in (
            (scene.render(5), manifest.camera()),
            (scene.render(5, "c2"), manifest.camera("c2")),
            (scene.render(5, moved), moved),
            (scene.render(5, "c3", (50, 70)), fitted),
        ):
            np.testing.assert_array_equal(found, render_splats(splats, camera, manifest.near_m))


def test_going_on_takes_what_is_new_and_no_more(library: Path) -> None:
    with Scene.open(library / "whole", renderer="cpu") as scene:
        scene.render(5)
        renderer = scene._renderer
        assert renderer is not None
        slice_bytes = random_slice(0).num_bytes
        # Going back needs the whole window, because the replaced slices are not known.
        for frame, slices in ((6, 1), (6, 0), (8, 2), (7, SWIN_SIZE), (7 + SWIN_SIZE, SWIN_SIZE)):
            before = renderer.uploaded_bytes
            scene.render(frame)
            assert renderer.uploaded_bytes - before == slices * slice_bytes


def test_a_notebook_s_loop_may_run_and_a_script_need_not_close_a_scene(
    server: ServerProcess,
) -> None:
    code = f"""
import asyncio, sys, player
assert not {{"numpy", "numba", "moderngl", "aiohttp"}} & set(sys.modules)
from player import Scene
assert not {{"av", "glfw"}} & set(sys.modules)
async def cell():
    scene = Scene.open({server.url + "/watch/busy"!r}, renderer="cpu")
    print(scene.render(7).shape)
asyncio.run(cell())
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "(48, 64, 3)\n"), done.stderr


def test_what_is_not_there_gets_one_line(library: Path, server: ServerProcess) -> None:
    with Scene.open(library / "whole", renderer="cpu") as scene:
        closed = Scene.open(library / "whole")
        closed.close()
        closed.close()
        calls: list[tuple[Callable[[], object], str]] = [
            *((lambda f=f: scene.splats(f), f"33 frames; there is no frame {f}") for f in (-1, 33)),
            (lambda: scene.render(33), "has 33 frames; there is no frame 33"),
            *((lambda s=s: scene.frames(*s), "whole has frames 0:33") for s in ((-1, 3),)),
            *((lambda s=s: scene.frames(*s), "whole has frames 0:33") for s in ((33,), (5, 5))),
            (lambda: scene.render(5, "nobody"), "no camera is called 'nobody'; there are c0, c1"),
            (lambda: closed.splats(3), "whole: the scene is closed; open it again"),
            (lambda: closed.render(3), "whole: the scene is closed; open it again"),
            (lambda: closed.__enter__(), "the scene is closed"),
            (lambda: Scene.open(library / "absent"), "absent is not a folder"),
            (lambda: Scene.open(f"{server.url}/watch/absent"), "absent/manifest.json"),
            (lambda: Scene.open(server.url), "serves 3 streams"),
            (lambda: Scene.open("http://127.0.0.1:9/s", delivery=HASTY), "cannot connect"),
            (lambda: Scene.open("ftp://host/s"), "only http:// and https:// URLs and folders"),
            (lambda: Scene.open("http://"), "it has no host"),
            (lambda: Scene.open("s", renderer="magic"), "renderer 'magic' is not one of auto, gl"),
            (lambda: Scene.open("s", gl="2"), "OpenGL version '2' is not one of auto"),
            (lambda: Scene.open(library / "whole", layers=4), "has 3 layers"),
        ]
        for call, message in calls:
            with pytest.raises(SwingsError, match=message) as caught:
                call()
            assert "\n" not in str(caught.value)
        assert scene.frames() == range(NUM_FRAMES)
        assert scene.frames(7) == range(7, NUM_FRAMES)


def test_a_picture_that_cannot_be_drawn_spoils_none_after_it(
    library: Path, expected: dict[tuple[str, int, int], Floats], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*arguments: object) -> None:
        raise KeyboardInterrupt

    with Scene.open(library / "busy", layers=2, renderer="cpu") as scene:
        scene.render(3)
        with monkeypatch.context() as patch:
            patch.setattr(CpuRenderer, "render", interrupted)
            with pytest.raises(KeyboardInterrupt):
                scene.render(30)
        for frame in (4, 30):
            picture = scene.render(frame, "c1")
            np.testing.assert_array_equal(picture, expected["busy", 2, frame])


def test_another_thread_is_told_to_open_a_scene_of_its_own(library: Path) -> None:
    with Scene.open(library / "whole", renderer="cpu") as scene, ThreadPoolExecutor(1) as pool:
        scene.render(3)
        with pytest.raises(InvalidError, match="another thread already draws"):
            pool.submit(scene.render, 3).result()


def test_a_live_stream_grows_when_it_is_asked_to(tmp_path: Path) -> None:
    with static_host(tmp_path) as host:
        with StreamWriter.create(tmp_path / "s", small_manifest()) as writer:
            births = iter(range(1 - SWIN_SIZE, 3 * SEGMENT_FRAMES))
            for birth in islice(births, SWIN_SIZE + SEGMENT_FRAMES):
                writer.append(random_slice(birth, SLICE_SIZE))
            with Scene.open(f"{host}/s") as scene:
                assert (scene.num_frames, scene.manifest.live) == (SEGMENT_FRAMES, True)
                with pytest.raises(InvalidError, match=f"there is no frame {SEGMENT_FRAMES}"):
                    scene.splats(SEGMENT_FRAMES)
                for birth in islice(births, SEGMENT_FRAMES):
                    writer.append(random_slice(birth, SLICE_SIZE))
                assert scene.refresh() == SEGMENT_FRAMES
                assert scene.refresh() == 0
                found = scene.splats(SEGMENT_FRAMES + 1)
            for birth in births:
                writer.append(random_slice(birth, SLICE_SIZE))
        expected = StreamReader(tmp_path / "s").active_splats(SEGMENT_FRAMES + 1, 3)
        assert same_splats(found, expected)


def test_a_server_that_comes_back_is_asked_again(
    library: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    second: list[ServerProcess] = []

    def pause(fetcher: Fetcher, seconds: float) -> None:
        if not second:
            second.append(ServerProcess(library, first.port))

    with (
        served(library) as first,
        Scene.open(f"{first.url}/watch/whole", delivery=SourceConfig(RetryConfig(0.5))) as scene,
    ):
        first.kill()
        monkeypatch.setattr(Fetcher, "pause", pause)
        assert len(scene.splats(20))
        second[0].kill()
        with pytest.raises(FetchError, match="cannot connect"):
            scene.splats(3)
