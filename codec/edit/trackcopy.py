"""Sound and captions that go along with a copy of a stream of the same frames and segments."""

from __future__ import annotations

from pathlib import Path

from codec.files import write_atomic
from codec.stream.captions import MAX_CAPTIONS_BYTES
from codec.stream.manifest import object_file, object_name
from codec.stream.reader import StreamReader, read_stream_file
from codec.stream.sound import MAX_SOUND_BYTES


def copy_tracks(reader: StreamReader, folder: Path) -> None:
    """Copies the objects of sound and the captions of the stream of `reader` to `folder`, which has
    the folders of its segments. Raises a CodecError."""
    for source in reader.manifest.sound:
        for record in reader.records:
            path = object_name(record.segment, source.part)
            data = read_stream_file(reader.storage, path, MAX_SOUND_BYTES)
            write_atomic(object_file(folder, record.segment, source.part), data)
    for captions in reader.manifest.captions:
        data = read_stream_file(reader.storage, captions.file_name, MAX_CAPTIONS_BYTES)
        write_atomic(folder / captions.file_name, data)
