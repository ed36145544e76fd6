"""Bytes that our writers never write; decoders must give a value or a CodecError for any bytes."""

from __future__ import annotations

import contextlib
import hashlib
import resource
import tracemalloc
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from codec.errors import CodecError
from codec.stream.manifest import Part, object_file
from codec.stream.reader import StreamReader
from codec.stream.segment import join_packets, pack_record
from tests.support.objects import object_packets


def refused(kind: Any, says: str, call: Callable[..., object], *arguments: Any, **more: Any) -> Any:
    """The error of `kind`, an exception or several, that the call raises; `says` is in its message,
    as a regular expression."""
    with pytest.raises(kind, match=says or None) as caught:
        call(*arguments, **more)
    return caught.value


def survives(decode: Callable[[bytes], object], data: bytes) -> bool:
    """Whether `decode` gave a value. Raises every error except CodecError."""
    with contextlib.suppress(CodecError):
        decode(data)
        return True
    return False


@contextlib.contextmanager
def within_bytes(limit_bytes: int) -> Iterator[None]:
    """Asserts that what is allocated inside stays below `limit_bytes`."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < limit_bytes
    finally:
        tracemalloc.stop()


@contextlib.contextmanager
def file_limit(limit_bytes: int) -> Iterator[None]:
    """Like a disk without room for more: the kernel reports a short write, then EFBIG."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def truncations(data: bytes) -> Iterable[bytes]:
    return (data[:length] for length in range(len(data)))


def flips(data: bytes, every: int = 1) -> Iterable[bytes]:
    """`data` with one byte changed in each of three ways, at every `every`-th place."""
    for place in range(0, len(data), every):
        for value in (data[place] ^ 1, data[place] ^ 0x80, 255 - data[place]):
            yield data[:place] + bytes([value]) + data[place + 1 :]


def put_object(stream: Path, segment: int, part: Part, data: bytes) -> None:
    """Replaces an object and updates the index, like a faulty writer."""
    reader = StreamReader(stream)
    number, num_layers = reader.manifest.part_number(part), reader.manifest.num_layers
    object_file(stream, segment, part).write_bytes(data)
    records = reader.records
    sizes = list(records[segment].part_bytes)
    hashes = list(records[segment].part_sha256)
    sizes[number], hashes[number] = len(data), hashlib.sha256(data).digest()
    records[segment] = replace(
        records[segment],
        object_bytes=tuple(sizes[:num_layers]),
        object_sha256=tuple(hashes[:num_layers]),
        side_bytes=tuple(sizes[num_layers:]),
        side_sha256=tuple(hashes[num_layers:]),
    )
    (stream / "index.bin").write_bytes(b"".join(map(pack_record, records)))


def put_packets(
    stream: Path, segment: int, part: Part, packets: Sequence[tuple[int, bytes]]
) -> None:
    """Replaces the (birth, packet) pairs of an object, see `put_object`."""
    put_object(stream, segment, part, join_packets(packets))


def packets_of(stream: Path, segment: int, part: Part) -> list[tuple[int, bytes]]:
    """(birth, packet) of each chunk of an object."""
    return object_packets(object_file(stream, segment, part).read_bytes())
