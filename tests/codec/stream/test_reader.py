"""Any slice and window of a stream on disk."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import CodecError, InvalidError
from codec.slice import Slice, active_splats, window_births
from codec.slots.decoder import SlotDecoder
from codec.slots.encoder import SlotEncoder
from codec.slots.slotlayout import SlotLayout, Update
from codec.splats import Splats
from codec.stream import StreamReader, StreamWriter
from codec.tools.audit import verify_stream
from tests.support.drawn import same_splats
from tests.support.hosted_streams import random_slice, small_manifest
from tests.support.hostile import refused
from tests.support.slots.folder import write_slots
from tests.support.slots.slot_streams import gaussians
from tests.support.slots.updates import small_layout
from tests.support.tiny_stream import SLICE_SIZE, append_tiny, tiny_manifest, tiny_slice

NUM_FRAMES = 10


def same_slice(a: Slice, b: Slice) -> bool:
    alike = a.birth == b.birth and (a.start_offsets == b.start_offsets).all()
    return bool(alike) and same_splats(a.splats, b.splats)


def played(updates: Sequence[Update], layout: SlotLayout, layers: int) -> dict[int, Slice]:
    """The whole slices of a stream by birth, without files."""
    encoder, decoder = SlotEncoder(layout), SlotDecoder(layout, layers)
    slices: dict[int, Slice] = {}
    for update in updates:
        encoded = encoder.append(update)
        if update.birth == 0:
            for chunk in encoder.keyframes()[:layers]:
                decoder.load(chunk.data)
            slices |= {b: decoder.whole(b) for b in window_births(0, layout.swin_size)}
        elif encoded is not None:
            changes = [change.data for change in encoded.changes[:layers]]
            decoder.apply(update.birth, encoded.skip_map.data, changes)
            slices[update.birth] = decoder.whole(update.birth)
    return slices


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("streams") / "finished"
    write_slots(path, NUM_FRAMES)
    return path


@pytest.fixture
def stream(finished: Path, tmp_path: Path) -> Path:
    """A copy that a test may alter."""
    return Path(shutil.copytree(finished, tmp_path / "stream"))


@given(
    swin_size=st.sampled_from([1, 2, 5]),
    segment_frames=st.sampled_from([1, 3, 8]),
    sh_degree=st.sampled_from([0, 1]),
    seed=st.integers(0, 1 << 32),
)
@settings(max_examples=12)
def test_any_slice_and_window_in_any_order(
    tmp_path_factory: pytest.TempPathFactory,
    swin_size: int,
    segment_frames: int,
    sh_degree: int,
    seed: int,
) -> None:
    path = tmp_path_factory.mktemp("order") / "s"
    layout = small_layout(swin_size, (5, 4, 3), sh_degree, segment_frames)
    updates = write_slots(path, 17, layout, seed % 1000)
    slices = {layers: played(updates, layout, layers) for layers in (1, 2, 3)}
    reader, rng = StreamReader(path), random.Random(seed)
    assert reader.births == range(1 - swin_size, 17)
    for _ in range(30):
        layers = rng.randrange(1, 4)
        if rng.random() < 0.5:
            birth = rng.choice(reader.births)
            assert same_slice(reader.slice(birth, layers), slices[layers][birth])
            continue
        frame = rng.randrange(17)
        window = reader.window(frame, layers)
        expected = [slices[layers][birth] for birth in window_births(frame, swin_size)]
        assert [part.birth for part in window] == [part.birth for part in expected]
        wanted = active_splats(expected, frame, swin_size)
        assert same_splats(active_splats(window, frame, swin_size), wanted)
        assert same_splats(reader.active_splats(frame, layers), wanted)
    for layers in (1, 3):
        for part in reader.slices(1 - swin_size, layers):
            assert same_slice(part, slices[layers][part.birth])
    assert verify_stream(path).num_frames == 17


def test_slices_that_were_sent_whole_show_at_any_frame(tmp_path: Path) -> None:
    """As in SwinGS: windows of five slices, with some Gaussians that start late."""
    manifest, num_frames = small_manifest(30, 1, swin_size=5, segment_frames=7), 20
    slices = [random_slice(birth, 30 - birth % 3, 1) for birth in range(-4, num_frames)]
    with StreamWriter.create(tmp_path / "s", manifest, exact=True) as writer:
        for part in slices:
            writer.append(part)
    assert any(part.start_offsets.any() for part in slices)
    reader = StreamReader(tmp_path / "s")
    frames = list(range(num_frames))
    random.Random(1).shuffle(frames)
    for frame in frames:
        window = [part for part in slices if part.birth in window_births(frame, 5)]
        expected = active_splats(window, frame, 5)
        assert gaussians(reader.active_splats(frame, 3)) == gaussians(expected)


def test_a_reader_of_one_layer_needs_no_other(stream: Path) -> None:
    for path in stream.glob("segments/*/1"):
        path.write_bytes(b"lost")
    for path in stream.glob("segments/*/keyframe-1"):
        path.unlink()
    reader = StreamReader(stream)
    assert len(reader.window(9, 1)) == 3
    assert len(list(reader.slices(-2, 1))) == 12
    refused(CodecError, "keyframe-1 is missing", reader.window, 9, 2)


def test_memory_of_reader_and_writer_is_bounded(tmp_path: Path) -> None:
    manifest = tiny_manifest()
    with StreamWriter.create(tmp_path / "s", manifest) as writer:
        for birth in range(-2, 60):
            writer.append(tiny_slice(birth))
            assert writer.num_packets <= 4 * 3 + 2
    assert writer.bytes_written == sum(
        p.stat().st_size for p in (tmp_path / "s").glob("segments/*/*")
    )
    reader = StreamReader(tmp_path / "s")
    for frame in range(60):
        reader.window(frame, 2)
        assert len(reader._objects) <= 2 * len(manifest.parts)


def test_each_slice_is_decoded_once(finished: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    decoded: list[int] = []
    apply = SlotDecoder.apply

    def counting(self: SlotDecoder, birth: int, *arguments: object) -> Slice:
        decoded.append(birth)
        return apply(self, birth, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(SlotDecoder, "apply", counting)
    reader = StreamReader(finished)
    for frame in range(NUM_FRAMES):
        reader.window(frame, 2)
        reader.window(frame, 2)
        reader.slice(frame, 1)
    assert decoded == list(range(1, NUM_FRAMES))


def test_arguments_out_of_range(finished: Path) -> None:
    reader = StreamReader(finished)
    named = (finished / name for name in ("manifest.json", "index.bin"))
    assert reader.overhead_bytes == sum(path.stat().st_size for path in named)
    wrong: list[Callable[[], object]] = [
        lambda: reader.slice(NUM_FRAMES, 1),
        lambda: reader.slice(-3, 1),
        lambda: reader.slice(0, 0),
        lambda: reader.slice(0, 3),
        lambda: reader.window(-1, 1),
        lambda: reader.window(NUM_FRAMES, 1),
        lambda: reader.decoder_at(NUM_FRAMES, 1),
        lambda: next(reader.slices(-3, 1)),
        lambda: reader.read_object(3, 0),
        lambda: reader.read_object(0, 2),
        lambda: reader.read_object(0, "keyframe-2"),
    ]
    for call in wrong:
        refused(InvalidError, "", call)


def test_a_growing_stream_is_followed(tmp_path: Path) -> None:
    path = tmp_path / "s"
    with StreamWriter.create(path, tiny_manifest()) as writer:
        reader = StreamReader(path)
        assert (reader.num_frames, reader.manifest.live, len(reader.births)) == (0, True, 0)
        append_tiny(writer, 6)
        assert (reader.refresh(), reader.num_frames) == (1, 4)
        slices = reader.slices(-2, 2)
        early = [next(slices) for _ in range(6)]
        append_tiny(writer, 9)
        assert reader.refresh() == 1
        assert (reader.num_frames, reader.manifest.live) == (8, True)
        assert reader.refresh() == 0
    assert reader.refresh() == 1
    assert (reader.num_frames, reader.manifest.live) == (9, False)
    late = list(slices)
    assert [part.birth for part in early + late] == list(range(-2, 9))
    fresh = StreamReader(path)
    assert all(same_slice(part, fresh.slice(part.birth, 2)) for part in early + late)
    assert len(Splats.concatenate([part.splats for part in late])) == SLICE_SIZE * len(late)


@pytest.mark.parametrize("path", ["absent", "a-file"])
def test_what_is_not_a_stream(tmp_path: Path, path: str) -> None:
    (tmp_path / "a-file").write_text("hello", encoding="utf-8")
    refused(CodecError, path, StreamReader, tmp_path / path)
    refused(CodecError, r"manifest\.json", StreamReader, tmp_path)
    refused(CodecError, "missing; this is not a whole swings stream", StreamWriter.resume, tmp_path)
