"""Places of the files in a packed stream, compared with those of Python's zipfile."""

from __future__ import annotations

import math
from pathlib import Path
from zipfile import ZIP_STORED, ZipFile

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import CodecError, CorruptError, UnsupportedError
from codec.stream.packedlayout import PackedHead, PackedLayout, packed_parts, read_layout
from codec.stream.segment import SegmentRecord, pack_record
from fuzz.seed import made_manifest, packed
from tests.support.hostile import refused, survives, truncations

MANIFEST = made_manifest().with_live(False)
MANIFEST_JSON = MANIFEST.to_json()
LAYERS = MANIFEST.num_layers


def layout_of(sizes: list[int], num_segments: int) -> PackedLayout:
    """sizes: bytes of the objects of each segment, in the order of the index."""
    count = MANIFEST.segment_frames
    records = [
        SegmentRecord(
            n,
            n * count,
            count,
            tuple(sizes[:LAYERS]),
            (bytes(32),) * LAYERS,
            (math.nan,) * LAYERS,
            tuple(sizes[LAYERS:]),
            (bytes(32),) * (LAYERS + 1),
        )
        for n in range(num_segments)
    ]
    index_bytes = len(pack_record(records[0])) * num_segments
    return PackedLayout(PackedHead(len(MANIFEST_JSON), index_bytes, 0, 0), MANIFEST, records)


@pytest.mark.parametrize(
    ("size_bytes", "num_segments"),
    [
        (7, 12),
        (1 << 30, 3),  # places beyond 4 GB
        (1, 65536 // (2 * LAYERS + 1) + 1),  # more entries than 16 bits can count
    ],
)
def test_zip_programs_find_the_files(tmp_path: Path, size_bytes: int, num_segments: int) -> None:
    layout = layout_of([size_bytes] * (2 * LAYERS + 1), num_segments)
    path = tmp_path / "sparse.swings"
    with open(path, "wb") as file:
        for at, piece in layout.structure(lambda path: 0):
            file.seek(at)
            file.write(piece)
    assert path.stat().st_size == layout.size_bytes
    with ZipFile(path) as archive:
        found = archive.infolist()
        assert [one.filename for one in found] == [name for name, _, _ in layout.files()]
        for one, (name, at, size) in zip(found, layout.files(), strict=True):
            extra_bytes = 24 if name == "manifest.json" else 0
            assert one.header_offset + 30 + len(name) + extra_bytes == at
            assert (one.file_size, one.compress_type) == (size, ZIP_STORED)
            if num_segments < 100:
                assert layout.find(name) == (at, size)


def test_what_a_player_needs_lies_side_by_side() -> None:
    parts = packed_parts(3)
    for layers in (1, 2, 3):
        changes = ["skipmaps", *range(layers)]
        keyframes = [f"keyframe-{layer}" for layer in range(layers)]
        for wanted in (changes, changes + keyframes):
            places = sorted(parts.index(part) for part in wanted)
            assert places == list(range(places[0], places[0] + len(wanted)))


@given(st.text(max_size=40))
@settings(max_examples=40, deadline=None)
def test_a_path_that_is_not_in_it_is_not_found(path: str) -> None:
    layout = layout_of([7] * (2 * LAYERS + 1), 2)
    names = {name for name, _, _ in layout.files()}
    assert (layout.find(path) is not None) == (path in names)
    for name in names:
        for other in (f"/{name}", f"{name}/", name.replace("0", "00"), name.upper()):
            assert other in names or layout.find(other) is None


def opened(data: bytes) -> PackedLayout:
    return read_layout(lambda at, most: (data[at : at + most], len(data)))


def test_sizes_that_lie_are_refused() -> None:
    data = packed(11, "art/still.png")
    assert opened(data).size_bytes == len(data)
    assert not any(survives(opened, cut) for cut in list(truncations(data))[::17])
    head_at = 43

    def put(at: int, value: int, width: int = 4) -> bytes:
        return data[:at] + value.to_bytes(width, "little") + data[at + width :]

    for lie in (
        put(18, 1 << 31),
        put(18, 0),
        put(head_at + 8, 0),
        put(head_at + 8, 1 << 29),
        put(head_at + 8, 1 << 27),
        put(head_at + 12, (1 << 20) + 1),
        put(head_at + 12, 4),
        put(head_at + 16, 4),  # there is no storyboard
        put(28, 0, 2),
        put(head_at + 20, 4),  # it has no sound and no captions
        data + b"\0",
        b"PK\3\4" + bytes(200),
    ):
        assert "\n" not in str(refused(CorruptError, "", opened, lie))
    for later in (put(head_at + 4, 2, 2), put(head_at + 6, 1, 2)):
        refused(UnsupportedError, "", opened, later)
    live = data.replace(b'"live": false', b'"live":  true')
    refused(CodecError, "it is live", opened, live)
