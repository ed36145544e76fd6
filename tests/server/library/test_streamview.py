"""Views: sent bytes match their hashes, and growth is distinguished from replacement."""

from __future__ import annotations

import asyncio
import hashlib
import json
import random
import shutil
import tempfile
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.errors import CodecError
from server.library import Library, ServedStream
from server.library.streamview import StreamView, continued, index_of, is_continued, view_of
from tests.support.server.running_server import SEGMENT_FRAMES, make_stream

NUM_SEGMENTS = 4


@pytest.fixture(scope="module")
def kinds(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three streams: the first two have the same manifest and different sizes, the third has
    another title."""
    root, count = tmp_path_factory.mktemp("kinds"), NUM_SEGMENTS * SEGMENT_FRAMES
    changes: list[dict[str, Any]] = [{}, {"num_empty": 1}, {"title": "c"}]
    return [make_stream(root / str(n), count, **change) for n, change in enumerate(changes)]


def files(stream: Path) -> tuple[bytes, bytes]:
    return (stream / "manifest.json").read_bytes(), (stream / "index.bin").read_bytes()


def as_live(manifest_json: bytes) -> bytes:
    return manifest_json.replace(b'"live": false', b'"live": true')


@settings(deadline=None)
@given(cuts=st.lists(st.integers(0, 10_000), max_size=6))
def test_however_it_grows_the_view_is_that_of_all_of_it(kinds: list[Path], cuts: list[int]) -> None:
    """The index is cut at any byte: a torn record is ignored until it is complete."""
    manifest_json, index = files(kinds[0])
    view, seen = view_of(as_live(manifest_json), b""), list[StreamView]()
    for cut in sorted(cut % (len(index) + 1) for cut in cuts):
        part = index[:cut]
        assert is_continued(view, as_live(manifest_json), part) == (cut >= view.index_bytes)
        view = continued(view, as_live(manifest_json), part)
        assert continued(view, as_live(manifest_json), part) is view
        seen.append(view)
    view = continued(view, manifest_json, index)
    whole = view_of(manifest_json, index)
    assert (view.index_sha256, view.index_data) == (whole.index_sha256, whole.index_data)
    assert view.num_frames == whole.num_frames == NUM_SEGMENTS * SEGMENT_FRAMES
    assert not view.manifest.live
    for one in [*seen, view]:
        assert hashlib.sha256(one.index_data).hexdigest() == one.index_sha256
        assert index.startswith(one.index_data)
        assert index_of(whole, one.num_segments) == one.index_data
    assert all(b.index_data.startswith(a.index_data) for a, b in pairwise(seen))


def test_another_stream_is_not_taken_for_growth(kinds: list[Path]) -> None:
    (manifest_json, a), (_, b), (other, c) = map(files, kinds)
    live = as_live(manifest_json)
    half = view_of(live, a[: len(a) // 2])
    assert is_continued(half, live, a)
    assert is_continued(half, manifest_json, a)
    assert is_continued(half, live.replace(b'"poster": null', b'"poster": "p.jpg"'), a)
    assert not is_continued(half, live, b), "other slices"
    assert not is_continued(half, live, b""), "begun anew"
    assert not is_continued(half, as_live(other), c), "another title"
    assert not is_continued(half, b"{", a)
    assert not is_continued(view_of(manifest_json, a), live, a), "finished, and live again"


@given(st.integers(0, 10_000), st.integers(1, 255))
def test_what_is_wrong_in_the_part_that_is_new_is_named(
    kinds: list[Path], at: int, flip: int
) -> None:
    manifest_json, index = files(kinds[0])
    record_bytes = len(index) // NUM_SEGMENTS
    view = view_of(as_live(manifest_json), index[: 2 * record_bytes])
    at = 2 * record_bytes + at % (2 * record_bytes)
    altered = index[:at] + bytes([index[at] ^ flip]) + index[at + 1 :]
    with pytest.raises(CodecError, match=r"^index\.bin: byte \d+: ") as caught:
        continued(view, manifest_json, altered)
    assert caught.value.at is not None
    assert caught.value.at // record_bytes == at // record_bytes


def test_the_index_of_a_finished_stream_ends_with_a_whole_record(kinds: list[Path]) -> None:
    manifest_json, index = files(kinds[0])
    with pytest.raises(CodecError, match=r"index\.bin: .* after the last whole record"):
        view_of(manifest_json, index[:-1])
    assert view_of(as_live(manifest_json), index[:-1]).num_segments == NUM_SEGMENTS - 1
    with pytest.raises(CodecError, match=r"^manifest\.json: "):
        view_of(json.dumps({"version": 1}).encode(), index)


class Told:
    """The bytes that clients received for each tag, which must never change."""

    def __init__(self) -> None:
        self.indexes: dict[int, bytes] = {}

    def check(self, library: Library) -> None:
        for stream in library.streams.values():
            view = stream.view
            assert hashlib.sha256(view.manifest_json).hexdigest() == view.manifest_sha256
            assert hashlib.sha256(view.index_data).hexdigest() == view.index_sha256
            before = self.indexes.get(stream.generation, b"")
            assert view.index_data.startswith(before), "one object, two streams"
            self.indexes[stream.generation] = view.index_data
            self.check_objects(stream)

    def check_objects(self, stream: ServedStream) -> None:
        for segment in range(stream.view.num_segments):
            for part in stream.view.manifest.parts:
                try:
                    data = stream.read_object(segment, part).data
                except CodecError:
                    continue  # a copy is in progress; the client gets an error, not other bytes
                assert hashlib.sha256(data).hexdigest() == stream.object_sha256(segment, part)


STEP = st.one_of(
    st.tuples(st.just("copy"), st.integers(0, 2), st.randoms(use_true_random=False)),
    st.tuples(st.just("rename"), st.integers(0, 2), st.just(None)),
    st.tuples(st.just("delete"), st.just(0), st.just(None)),
)


@settings(max_examples=25, deadline=None)
@given(steps=st.lists(STEP, min_size=1, max_size=4), looks=st.randoms(use_true_random=False))
def test_whatever_is_put_in_its_place_a_tag_never_changes_its_bytes(
    kinds: list[Path], steps: list[tuple[str, int, object]], looks: object
) -> None:
    """Streams are replaced file by file in any order, with reads at any time in between."""
    assert isinstance(looks, random.Random)
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "root"
        path = root / "s"
        root.mkdir()
        library, told = Library(root, 1.0), Told()

        def look(always: bool = False) -> None:
            if always or looks.random() < 0.3:
                scan(library)
                told.check(library)

        last: Path | None = None
        for number, (what, kind, order) in enumerate(steps):
            if what == "copy":
                last = kinds[kind]
                names = [p.relative_to(last) for p in sorted(last.rglob("*")) if p.is_file()]
                assert isinstance(order, random.Random)
                order.shuffle(names)
                for name in names:
                    (path / name).parent.mkdir(parents=True, exist_ok=True)
                    shutil.copy(last / name, path / name)
                    look()
            else:
                if path.exists():
                    path.rename(root / f".away{number}")
                last = None if what == "delete" else kinds[kind]
                if last is not None:
                    shutil.copytree(last, path)
                look()
        look(always=True)
        assert library.broken == {}
        if last is None:
            assert library.streams == {}
        else:
            assert library.streams["s"].view.index_data == (last / "index.bin").read_bytes()


def scan(library: Library) -> None:
    asyncio.run(library.look())
