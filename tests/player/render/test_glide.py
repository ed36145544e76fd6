"""Pictures between two frames, by every renderer."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from codec.camera import Camera
from codec.framerange import FrameRange
from codec.interop.formats import SplatFormat, encode_splats
from codec.lattice.lattice import Lattice, States, quantise
from codec.sequence.importing import ImportOptions, import_stream
from codec.slots.slotlayout import NEW, PREDICTED, SlotLayout, Update
from codec.splats import Splats
from codec.stream import StreamReader, StreamWriter
from player.playout.assembler import Assembler
from player.render.cpu import render_splats
from player.render.gl import create_renderer
from player.render.renderer import GlVersion, Renderer, RendererKind
from player.source.directory import DirectorySource
from tests.support.deforming import Deforming
from tests.support.hosted_streams import random_splats
from tests.support.screen.opengl import GL_VERSIONS
from tests.support.slots.slot_streams import slot_manifest, write_busy_stream
from tests.support.slots.trained_updates import trained_like_layout

NUM_FRAMES = 9
STEP_M = np.array([0.09, 0.03, 0.0], np.float32)
"""Movement of the body per frame, in the world."""


@pytest.fixture(params=["cpu", *GL_VERSIONS])
def kind(request: pytest.FixtureRequest) -> tuple[RendererKind, GlVersion]:
    return CPU if request.param == "cpu" else (RendererKind.GL, GlVersion(request.param))


CPU = RendererKind.CPU, GlVersion.AUTO


class Player:
    """A stream in a renderer, frame by frame."""

    def __init__(self, path: Path, kind: tuple[RendererKind, GlVersion] = CPU) -> None:
        self.source = DirectorySource(path, FrameRange(), None)
        self.manifest = self.source.manifest
        self._packets = list(self.source.packets())
        self._assembler = Assembler(self.manifest, self.source.num_layers, 0)
        self.renderer: Renderer = create_renderer(kind[0], self.manifest, kind[1])
        self.camera: Camera = self.manifest.camera().fitted(192, 108)

    def go_to(self, frame: int, with_motion: bool = True) -> None:
        due = [one for one in self._packets if max(0, one.first_frame) == frame]
        for slice in self._assembler.assemble(frame, due, with_motion):
            self.renderer.put(slice)
        self.renderer.upload(frame)

    def picture(self, frame: int) -> np.ndarray:
        return self.renderer.render_again(frame, self.camera)


@pytest.fixture
def busy(tmp_path: Path) -> Path:
    return write_busy_stream(tmp_path / "s", NUM_FRAMES, trained_like_layout(60, 3, 4))


def test_frames_stay_exact_however_one_glides_between_them(
    busy: Path, kind: tuple[RendererKind, GlVersion]
) -> None:
    straight, exact = Player(busy), Player(busy)
    twin, rng = Player(busy, kind), np.random.default_rng(0)
    pictures = []
    for frame in range(NUM_FRAMES):
        twin.go_to(frame)
        straight.go_to(frame, with_motion=False)
        assert not straight.renderer.glide(0.3)
        pictures.append(twin.picture(frame))
        for share in sorted(rng.random(3)):
            moves = twin.renderer.glide(float(share))
            assert moves == (frame > 0)
            assert not twin.renderer.glide(float(share))
        if frame % 2:  # else the next upload has to correct it
            twin.renderer.glide(1.0)
            assert np.array_equal(twin.picture(frame), pictures[-1])
    for frame in range(NUM_FRAMES):
        exact.go_to(frame)
        assert np.abs(exact.picture(frame) - pictures[frame]).max() < 2e-3
    twin.renderer.close()


def write_body(path: Path) -> Splats:
    """Writes a stream in which a body of one lane moves by STEP_M per frame; returns frame 0."""
    body = random_splats(50, 0, 3)
    lattice = Lattice.suiting(body)
    layout = SlotLayout(1, (len(body),), 0, (lattice,), 4)
    manifest = slot_manifest(layout)
    with StreamWriter.create(path, manifest) as writer:
        states: States | None = None
        for birth in range(NUM_FRAMES):
            made, fits = quantise(moved(body, birth), lattice)
            assert fits.all()
            if states is not None:
                made = States(made.positions, states.attributes)
            statuses = np.full(len(body), NEW if birth == 0 else PREDICTED, np.uint8)
            nothing = np.zeros(len(body), np.uint8)
            writer.append(Update(birth, statuses, made, nothing, nothing > 0, Splats.empty(0)))
            states = made
    return body


def moved(body: Splats, frames: float) -> Splats:
    return Splats(body.means + np.float32(frames) * STEP_M, *body.arrays[1:])


def psnr_db(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(((a.astype(np.float64) - b) ** 2).mean() + 1e-12))


def test_half_way_it_looks_as_it_would_half_way(
    tmp_path: Path, kind: tuple[RendererKind, GlVersion]
) -> None:
    body = write_body(tmp_path / "s")
    player = Player(tmp_path / "s", kind)
    with closing(player.renderer):
        for frame in range(4):
            player.go_to(frame)
        there = player.picture(3)
        for share in (0.25, 0.5, 0.75):
            player.renderer.glide(share)
            found = player.picture(3)
            camera, near_m = player.camera, player.manifest.near_m
            truth = render_splats(moved(body, 2 + share), camera, near_m)
            before = render_splats(moved(body, 2), camera, near_m)
            assert psnr_db(found, truth) > 30
            assert psnr_db(found, truth) > psnr_db(there, truth) + 6
            assert psnr_db(found, truth) > psnr_db(before, truth) + 6


@pytest.fixture(scope="module", params=[0, 3])
def deforming(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A stream in which all Gaussians move, and a tenth of the slots gets others in each frame."""
    folder = tmp_path_factory.mktemp("deforming")
    (folder / "seq").mkdir()
    model = Deforming(400, request.param)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tests.support.deforming.BORN_SHARE", 0.1)
        for number in range(NUM_FRAMES):
            (folder / "seq" / f"{number}.ply").write_bytes(
                encode_splats(model.next(), SplatFormat.PLY)
            )
    import_stream(folder / "seq", folder / "stream", ImportOptions(fps=30.0))
    return folder / "stream"


def test_all_renderers_draw_the_same_between_frames(
    deforming: Path, kind: tuple[RendererKind, GlVersion]
) -> None:
    player, oracle = Player(deforming, kind), Player(deforming)
    reader = StreamReader(deforming)
    layers, near_m = reader.manifest.num_layers, reader.manifest.near_m
    with closing(player.renderer):
        for frame in range(1, 6):
            if frame == 1:
                player.go_to(0)
                oracle.go_to(0)
            player.go_to(frame)
            oracle.go_to(frame)
            motion = reader.motion(frame - 1, frame, layers)
            assert len(motion.leaving) > 10
            for share in (0.75, 0.25, 1.0):
                player.renderer.glide(share)
                oracle.renderer.glide(share)
                expected = oracle.picture(frame)
                assert psnr_db(player.picture(frame), expected) > (45 if share < 1 else 60)
                exact = render_splats(motion.all_at(share), player.camera, near_m)
                assert psnr_db(exact, expected) > 60


def test_what_is_uploaded_for_pictures_between_is_little(
    deforming: Path, kind: tuple[RendererKind, GlVersion]
) -> None:
    if kind[0] is RendererKind.CPU:
        pytest.skip("nothing is uploaded to the CPU")
    player, plain = Player(deforming, kind), Player(deforming, kind)
    with closing(player.renderer), closing(plain.renderer):
        for frame in range(NUM_FRAMES):
            player.go_to(frame)
            plain.go_to(frame, with_motion=False)
            if frame == 0:
                first = player.renderer.uploaded_bytes, plain.renderer.uploaded_bytes
            for share in (0.25, 0.5, 0.75, 1.0):
                player.renderer.glide(share)
        between = player.renderer.uploaded_bytes - first[0]
        assert between <= 1.6 * (plain.renderer.uploaded_bytes - first[1])
