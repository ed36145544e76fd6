"""The content of a stream at one time, and whether a later view is the same stream, grown.

Rule: pure. The bytes that are sent are the bytes that were hashed and read.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field, replace

from codec.errors import CodecError
from codec.stream.integrity import check_index_end, read_index
from codec.stream.manifest import MANIFEST_NAME, Manifest
from codec.stream.segment import INDEX_NAME, SegmentRecord, record_bytes


@dataclass(frozen=True, slots=True)
class StreamView:
    """The content of a stream at one time: immutable, so its users see no half-done change."""

    manifest: Manifest
    manifest_json: bytes
    manifest_sha256: str
    records: tuple[SegmentRecord, ...]
    index_data: bytes
    """The whole records of index.bin."""
    index_sha256: str
    identity: bytes
    """Equal in all views of one stream."""
    _hash: hashlib._Hash = field(repr=False, compare=False)
    """Hash of index_data; only copies of it are updated."""

    @property
    def num_segments(self) -> int:
        return len(self.records)

    @property
    def num_frames(self) -> int:
        return self.records[-1].first_frame + self.records[-1].num_frames if self.records else 0

    @property
    def index_bytes(self) -> int:
        return len(self.index_data)


def view_of(manifest_json: bytes, index: bytes) -> StreamView:
    """The view of a stream with these files. Raises a CodecError that names the file."""
    manifest = _parsed(manifest_json)
    empty = StreamView(
        manifest,
        manifest_json,
        hashlib.sha256(manifest_json).hexdigest(),
        (),
        b"",
        "",
        _identity(manifest_json),
        hashlib.sha256(),
    )
    return _with_records(empty, index)


def is_continued(view: StreamView, manifest_json: bytes, index: bytes) -> bool:
    """Whether the files are those of the stream of `view`, perhaps grown, perhaps finished: the
    manifest says the same but for what finishing changes, and the index begins alike."""
    try:
        manifest = _parsed(manifest_json)
    except CodecError:
        return False
    revived = manifest.live and not view.manifest.live
    return (
        not revived
        and _identity(manifest_json) == view.identity
        and index.startswith(view.index_data)
    )


def continued(view: StreamView, manifest_json: bytes, index: bytes) -> StreamView:
    """The view after `view`, of which the files are a continuation; `view` itself if they bring
    nothing. Raises a CodecError that names the file if what is new is wrong."""
    if manifest_json == view.manifest_json:
        return _with_records(view, index)
    manifest = _parsed(manifest_json)
    sha256 = hashlib.sha256(manifest_json).hexdigest()
    described = replace(
        view, manifest=manifest, manifest_json=manifest_json, manifest_sha256=sha256
    )
    return _with_records(described, index)


def index_of(view: StreamView, num_segments: int) -> bytes:
    """The index as it was when the stream had `num_segments`."""
    return view.index_data[: num_segments * _record_bytes(view.manifest)]


def _with_records(view: StreamView, index: bytes) -> StreamView:
    """`view` with all whole records of `index`, which begins with its own."""
    manifest, begin = view.manifest, view.index_bytes
    try:
        fresh = read_index(index[begin:], manifest, view.records)
    except CodecError as error:
        raise error.within(INDEX_NAME, begin) from error
    records = (*view.records, *fresh)
    try:
        check_index_end(len(index), manifest, len(records))
    except CodecError as error:
        raise error.within(INDEX_NAME) from error
    if not fresh and view.index_sha256:
        return view
    whole = index[: len(records) * _record_bytes(manifest)]
    fed = view._hash.copy()
    fed.update(whole[begin:])
    return replace(view, records=records, index_data=whole, index_sha256=fed.hexdigest(), _hash=fed)


def _record_bytes(manifest: Manifest) -> int:
    return record_bytes(manifest.num_layers)


def _parsed(manifest_json: bytes) -> Manifest:
    try:
        return Manifest.from_json(manifest_json)
    except CodecError as error:
        raise error.within(MANIFEST_NAME) from error


def _identity(manifest_json: bytes) -> bytes:
    """The content of a manifest, without the fields that finishing a stream changes."""
    value = json.loads(manifest_json)
    said = {key: value[key] for key in value if key not in ("live", "poster", "storyboard")}
    return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).digest()
