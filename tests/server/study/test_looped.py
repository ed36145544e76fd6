"""A repeated stream: the sizes of each frame are those of the index, in every round."""

from __future__ import annotations

from pathlib import Path

import pytest

from codec.errors import InvalidError
from codec.stream import StreamReader, StreamWriter
from server.abr.media import segment_sizes
from server.study.looped import open_media
from tests.support.slots.folder import slots_manifest, write_slots
from tests.support.slots.updates import patternless_updates

FRAMES, FPS, SEGMENT = 14, 25.0, 4


@pytest.fixture(scope="module")
def stream(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A stream with three segments of 4 frames and one of 2."""
    path = tmp_path_factory.mktemp("looped") / "stream"
    write_slots(path, FRAMES)
    return path


def test_what_is_not_longer_than_the_stream_is_the_stream(stream: Path) -> None:
    media = open_media(stream, FRAMES / FPS)
    reader = StreamReader(stream)
    assert media.num_frames == FRAMES
    assert (media.fps, media.num_layers) == (FPS, 2)
    for birth in range(FRAMES):
        record = reader.records[reader.manifest.segment_of(birth)]
        assert media.sizes(birth) == segment_sizes(record, reader.manifest)


def test_a_longer_play_repeats_the_whole_segments(stream: Path) -> None:
    media = open_media(stream, 100 / FPS)
    assert media.num_frames == 100
    assert len(media.segments) == 3
    for birth in range(100):
        assert media.sizes(birth) is media.segments[birth // SEGMENT % 3]


def test_a_stream_of_less_than_a_segment_is_repeated_as_it_is(tmp_path: Path) -> None:
    write_slots(tmp_path / "short", 3)
    media = open_media(tmp_path / "short", 1.0)
    assert (media.segment_frames, media.num_frames) == (3, 25)
    assert media.sizes(24) is media.segments[0]


def test_what_it_needs_is_bytes_over_time(stream: Path) -> None:
    media = open_media(stream, 48 / FPS)
    slices_bytes = [sum(media.sizes(frame).layer_bytes) for frame in range(48)]
    assert media.need_bps == pytest.approx(8 * sum(slices_bytes) / (48 / FPS))


def test_a_bitrate_scales_all_sizes_alike(stream: Path) -> None:
    media = open_media(stream, 2.0)
    scaled = media.with_bitrate(36e6)
    assert scaled.need_bps == pytest.approx(36e6)
    factor = 36e6 / media.need_bps
    for one, other in zip(media.segments, scaled.segments, strict=True):
        assert other.layer_bytes == pytest.approx([factor * size for size in one.layer_bytes])
        assert other.snapshot_bytes == pytest.approx([factor * size for size in one.snapshot_bytes])
        assert (other.psnr_db, other.changed_shares) == (one.psnr_db, one.changed_shares)
    assert scaled.num_frames == media.num_frames


def test_a_stream_without_frames_is_refused(tmp_path: Path) -> None:
    manifest = slots_manifest()
    update, *_ = patternless_updates(manifest.slot_layout, 1)
    with StreamWriter.create(tmp_path / "live", manifest) as writer:
        writer.append(update)
        with pytest.raises(InvalidError, match="no frames yet"):
            open_media(tmp_path / "live", 1.0)
