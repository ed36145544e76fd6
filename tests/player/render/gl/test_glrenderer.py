"""OpenGL compared with the CPU renderer: same picture, and only the changed slice is uploaded."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.arrays import Doubles
from codec.camera import Camera
from codec.errors import InvalidError
from codec.slice import Slice
from codec.stream.manifest import Manifest
from player.render.cpu import CpuRenderer, Ring, render_depth, render_splats
from player.render.gl import GlError, GlRenderer, Target, glrenderer, open_context, resident
from player.render.renderer import GlVersion
from tests.player.render.test_glide import psnr_db
from tests.support.hosted_streams import SWIN_SIZE, random_slice, random_splats, small_manifest
from tests.support.screen.opengl import GL_VERSIONS, NO_GL43
from tests.support.slots.leases import LeasedStream, leased_streams, replayed

OpenGl = Callable[..., GlRenderer]


@pytest.fixture(params=GL_VERSIONS)
def version(request: pytest.FixtureRequest) -> GlVersion:
    return GlVersion(request.param)


@pytest.fixture
def open_gl(version: GlVersion) -> Iterator[OpenGl]:
    """A factory of renderers, which are closed after the test."""
    opened: list[GlRenderer] = []

    def opening(manifest: Manifest, target: Target = Target.FLOAT32) -> GlRenderer:
        opened.append(GlRenderer(manifest, target, version=version))
        return opened[-1]

    yield opening
    for renderer in opened:
        renderer.close()


def put_window(gl: GlRenderer, count: int, sh_degree: int = 1) -> None:
    """The slices of frame 0."""
    for birth in range(1 - SWIN_SIZE, 1):
        gl.put(random_slice(birth, count, sh_degree))


def assert_as_on_cpu(
    gl: GlRenderer, manifest: Manifest, slices: Iterable[Slice], cameras: Sequence[Camera] = ()
) -> None:
    """Draws each frame of `slices`, which another thread puts, from `cameras` or the default."""
    cpu = CpuRenderer(manifest)
    for slice in slices:
        thread = threading.Thread(target=gl.put, args=(slice,))
        thread.start()
        thread.join()
        cpu.put(slice)
        for camera in cameras or [manifest.camera()]:
            if slice.birth >= 0:
                expected, got = cpu.render(slice.birth, camera), gl.render(slice.birth, camera)
                assert expected.max() > 0.5
                assert got.shape == (camera.height_px, camera.width_px, 3)
                assert got.dtype == np.float32
                assert psnr_db(got, expected) >= 60


@pytest.mark.parametrize("sh_degree", [0, 1, 2, 3])
def test_parity_with_the_cpu(open_gl: OpenGl, sh_degree: int) -> None:
    manifest = small_manifest(slice_size=500, sh_degree=sh_degree)
    cameras = [
        manifest.camera("c0"),
        # Odd size, principal point off the middle, pixels not square.
        replace(manifest.camera("c1"), width_px=95, height_px=51, cx_px=40.0, fy_px=75.0),
        # Among the Gaussians: many are behind, outside the picture, and nearer than near_m.
        replace(manifest.camera("c0"), w2c=shift(-3.9)),
    ]
    slices = (random_slice(birth, 500, sh_degree) for birth in range(1 - SWIN_SIZE, 6))
    assert_as_on_cpu(open_gl(manifest), manifest, slices, cameras)


def shift(z_m: float) -> Doubles:
    """The pose of a camera moved backwards by `z_m`."""
    w2c = np.eye(4)
    w2c[2, 3] = z_m
    return w2c


@pytest.mark.parametrize(("target", "least_db"), [(Target.FLOAT16, 52), (Target.BYTE, 45)])
def test_coarser_targets_are_near(open_gl: OpenGl, target: Target, least_db: float) -> None:
    # Degree 0 and few layers, because 8 bits round and clip every blended layer.
    manifest = small_manifest(slice_size=60, sh_degree=0)
    gl, cpu = open_gl(manifest, target), CpuRenderer(manifest)
    for birth in range(1 - SWIN_SIZE, 1):
        slice = random_slice(birth, 60, 0)
        gl.put(slice)
        cpu.put(slice)
    expected = np.clip(cpu.render(0, manifest.camera()), 0, 1)
    got = gl.render(0, manifest.camera())
    assert psnr_db(got, expected) >= least_db
    if target is Target.BYTE:
        np.testing.assert_array_equal(got, np.rint(got * 255) / np.float32(255))


def test_a_pixel_has_the_depth_that_the_cpu_finds(open_gl: OpenGl) -> None:
    manifest = small_manifest(slice_size=500, sh_degree=2)
    gl, ring, camera = open_gl(manifest), Ring(SWIN_SIZE, 500, 2), manifest.camera("c1")
    for birth in range(1 - SWIN_SIZE, 1):
        gl.put(random_slice(birth, 500, 2))
        ring.put(random_slice(birth, 500, 2))
    gl.render(0, camera)
    expected = render_depth(ring.active(0), camera, manifest.near_of(camera))
    for (y, x), depth_m in np.ndenumerate(expected[::7, ::9]):
        found = gl.depth_at(camera, 9 * x + 0.7, 7 * y + 0.2)
        np.testing.assert_allclose(np.nan if found is None else found, depth_m, rtol=1e-3)
    assert 0 < np.isnan(expected[::7, ::9]).mean() < 1


def test_of_equally_far_gaussians_the_oldest_is_in_front(open_gl: OpenGl) -> None:
    # Quantisation puts both parts of a split Gaussian at the same place, as do slices that change
    # little. Colours are opaque, so that another order would give another picture.
    manifest = small_manifest(slice_size=30, sh_degree=0)
    slices = []
    for birth in range(1 - SWIN_SIZE, 4):
        splats = random_splats(30, 0, birth + 70)
        splats.means[:] = np.repeat(random_splats(10, 0, 5).means, 3, axis=0)
        splats.logit_opacities[:] = 3
        slices.append(Slice(birth, splats, np.zeros(30, np.uint8)))
    assert_as_on_cpu(open_gl(manifest), manifest, slices)


@pytest.mark.parametrize("swin_size", [1, 5])
def test_the_renderer_draws_the_ring(open_gl: OpenGl, swin_size: int) -> None:
    manifest = small_manifest(slice_size=100, swin_size=swin_size)
    gl, ring = open_gl(manifest), Ring(swin_size, 100, 1)
    camera = manifest.camera()
    # Slices shrink and grow as a server drops and adds layers; one lane is empty for a while.
    for birth, count in enumerate([100, 3, 0, 60, 1, 100, 2], 1 - swin_size):
        slice = random_slice(birth, count)
        gl.put(slice)
        ring.put(slice)
        if birth >= 0:
            expected = render_splats(ring.active(birth), camera, manifest.near_m)
            assert psnr_db(gl.render(birth, camera), expected) >= 60


def test_a_camera_has_a_near_plane_of_its_own(open_gl: OpenGl) -> None:
    manifest = small_manifest(slice_size=100)
    own = tuple(np.linspace(3.5, 4.5, len(manifest.cameras)).tolist())
    manifest = replace(manifest, camera_near_m=own)
    gl, cpu, ring = open_gl(manifest), CpuRenderer(manifest), Ring(SWIN_SIZE, 100, 1)
    for birth in range(1 - SWIN_SIZE, 1):
        for player in (gl, cpu, ring):
            player.put(random_slice(birth, 100))
    for camera, near_m in zip(manifest.cameras, own, strict=True):
        expected = render_splats(ring.active(0), camera, near_m)
        assert psnr_db(expected, render_splats(ring.active(0), camera, manifest.near_m)) < 40
        np.testing.assert_array_equal(cpu.render(0, camera), expected)
        assert psnr_db(gl.render(0, camera), expected) >= 60


def test_only_the_changed_slice_is_uploaded(open_gl: OpenGl) -> None:
    manifest = small_manifest(slice_size=1024, sh_degree=0)
    gl = open_gl(manifest)
    slice_bytes = 1024 * 64  # two whole rows of 512 Gaussians
    put_window(gl, 1024, 0)
    assert gl.uploaded_bytes == 0
    gl.render(0, manifest.camera())
    assert gl.uploaded_bytes == SWIN_SIZE * slice_bytes
    for frame in range(1, 6):
        gl.put(random_slice(frame, 1024, 0))
        gl.render(frame, manifest.camera())
        gl.render(frame, manifest.camera("c1"))
        assert gl.uploaded_bytes == (SWIN_SIZE + frame) * slice_bytes
    # Late starts need no upload: the same slices show more Gaussians a frame later.
    before = gl.uploaded_bytes
    gl.render(6, manifest.camera())
    assert gl.uploaded_bytes == before


@pytest.mark.parametrize("version", GL_VERSIONS)
@settings(max_examples=6)
@given(leased_streams(slice_sizes=(1, 7, 1100)), st.booleans(), st.integers(1, 3))
def test_changes_are_drawn_as_a_plain_replay(
    version: GlVersion, stream: LeasedStream, all_at_once: bool, step: int
) -> None:
    manifest = small_manifest(
        stream.slice_size, stream.sh_degree, swin_size=stream.swin_size, layers=(1.0,)
    )
    gl, plain = GlRenderer(manifest, version=version), GlRenderer(manifest, version=version)
    try:
        waiting = list(stream.slices)
        # Frames may be left out; slices may be put long before they are due.
        for frame in range(0, stream.num_frames, step):
            while waiting and (all_at_once or waiting[0].birth <= frame):
                gl.put(waiting.pop(0))
            first_birth = frame - stream.swin_size + 1
            for birth, splats in enumerate(
                replayed(stream.slices, frame, stream.swin_size), first_birth
            ):
                plain.put(Slice(birth, splats, np.zeros(len(splats), np.uint8)))
            camera = manifest.camera()
            np.testing.assert_array_equal(gl.render(frame, camera), plain.render(frame, camera))
    finally:
        gl.close()
        plain.close()


def test_only_the_changed_rows_are_uploaded(open_gl: OpenGl) -> None:
    manifest = small_manifest(slice_size=2048, sh_degree=0)
    gl = open_gl(manifest)
    put_window(gl, 2048, 0)
    gl.upload(0)
    for frame, rows in enumerate(([], [700], range(512, 1536), range(0, 2048, 2)), 1):
        before = gl.uploaded_bytes
        splats = random_splats(len(rows), 0, frame)
        offsets = np.zeros(len(rows), np.uint8)
        gl.put(Slice(frame, splats, offsets, np.array(rows, np.int32)))
        gl.upload(frame)
        expected_bytes = (64 + 4) * len(rows)
        if gl.version is GlVersion.V33:
            # Every second of the last ones; those between go along, except one per row.
            expected_bytes = 64 * (len(rows) if frame < 4 else 4 * 511)
        assert gl.uploaded_bytes - before == expected_bytes


@pytest.mark.realtime
def test_other_threads_run_while_a_frame_is_drawn(open_gl: OpenGl) -> None:
    manifest, ticks_s, done = small_manifest(20_000, 0), list[float](), threading.Event()
    gl = open_gl(manifest)
    put_window(gl, 20_000, 0)
    gl.render(0, manifest.camera())

    def tick() -> None:
        while not done.wait(0.001):
            ticks_s.append(time.perf_counter())

    with ThreadPoolExecutor(1) as pool:
        pool.submit(tick)
        began_s = time.perf_counter()
        gl.render(0, manifest.camera())
        took_s = time.perf_counter() - began_s
        done.set()
    if took_s < 0.05:
        pytest.skip(f"drawn in {took_s:.3f} s: too fast to tell")
    assert len([t for t in ticks_s if began_s < t < began_s + took_s]) >= 5


def test_a_window_gets_the_picture_the_right_way_up(version: GlVersion) -> None:
    manifest = small_manifest(slice_size=200)
    context = open_context(version)
    gl = GlRenderer(manifest, context=context, version=version)
    try:
        put_window(gl, 200)
        camera = manifest.camera()
        expected = gl.render(0, camera)
        # Larger than the picture, like a window that was just resized.
        screen = context.framebuffer([context.renderbuffer((100, 90), 4, dtype="f1")])
        gl.present(0, camera, screen)
        area = (0, 0, camera.width_px, camera.height_px)
        data = screen.read(area, components=3, alignment=1)
        # OpenGL's first row is the lowest row of a window.
        shown = np.frombuffer(data, np.uint8).reshape(camera.height_px, camera.width_px, 3)[::-1]
        assert np.abs(shown - np.clip(expected, 0, 1) * 255).max() <= 0.51
        np.testing.assert_array_equal(gl.render(0, camera), expected)
    finally:
        gl.close()
        context.release()


def test_sizes_may_change_and_what_does_not_fit_is_refused(open_gl: OpenGl) -> None:
    manifest = small_manifest(slice_size=10)
    gl = open_gl(manifest)
    assert gl.render(0, manifest.camera()).max() == 0
    for width_px in (8, 500, 8):
        camera = manifest.camera().resized(width_px, 30)
        assert gl.render(0, camera).shape == (30, width_px, 3)
    with pytest.raises(InvalidError, match="11 Gaussians"):
        gl.put(random_slice(0, 11))
    rows = np.array([10], np.int32)
    with pytest.raises(InvalidError, match="changes row 10; a lane has 10"):
        gl.put(Slice(0, random_splats(1, 1, 0), np.zeros(1, np.uint8), rows))
    gl._offscreen.limit_px = 63
    with pytest.raises(GlError, match="up to 63 pixels wide and high, not 64x48"):
        gl.render(0, manifest.camera())
    gl.close()
    gl.close()


def test_without_the_system_s_library_moderngl_draws_the_same(
    open_gl: OpenGl, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(name: str) -> None:
        raise OSError(name)

    manifest = small_manifest(slice_size=50)
    usual = open_gl(manifest)
    monkeypatch.setattr("player.render.gl.context.ctypes.CDLL", missing)
    other = open_gl(manifest)
    for birth in range(1 - SWIN_SIZE, 1):
        usual.put(random_slice(birth, 50))
        other.put(random_slice(birth, 50))
    drawn = usual.render(0, manifest.camera())
    assert drawn.max() > 0.5
    np.testing.assert_array_equal(other.render(0, manifest.camera()), drawn)


@pytest.mark.skipif(NO_GL43 is not None, reason=f"OpenGL: {NO_GL43}")
def test_what_4_3_cannot_hold_is_drawn_with_3_3(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(*_: object) -> None:
        raise GlError("too many for this GPU")

    monkeypatch.setattr(resident, "_check_limits", refuse)
    monkeypatch.setattr(glrenderer, "version_for", lambda *_: GlVersion.V43)
    manifest = small_manifest(slice_size=10)
    with closing(GlRenderer(manifest)) as gl:
        assert gl.name.startswith("OpenGL 3.3, ")
        gl.put(random_slice(0, 10))
        assert gl.render(0, manifest.camera()).max() > 0
    assert caplog.messages == ["drawing with OpenGL 3.3: too many for this GPU"]
    with pytest.raises(GlError, match="too many for this GPU"):
        GlRenderer(manifest, version=GlVersion.V43)


@pytest.mark.parametrize("version", GL_VERSIONS)
def test_a_stream_too_large_for_opengl_is_refused(version: GlVersion) -> None:
    manifest = small_manifest(slice_size=1 << 20, swin_size=16)
    context = open_context(version)
    limit_bytes = context.info["GL_MAX_SHADER_STORAGE_BLOCK_SIZE"]
    context.release()
    if version is GlVersion.V43 and limit_bytes >= 96 << 24:
        pytest.skip(f"this OpenGL has buffers of {limit_bytes} bytes")
    with pytest.raises(GlError, match=r"16777216 Gaussians need a (texture|buffer) of"):
        GlRenderer(manifest, version=version)
