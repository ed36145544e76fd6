"""ZIP archives: contents round-trip, and hostile archives cost no more than their bytes."""

from __future__ import annotations

import io
import zipfile

import pytest

from codec.errors import CodecError, CorruptError, UnsupportedError
from codec.foreign.bundle import MAX_DIRECTORY_BYTES, Bundle, encode_bundle
from tests.support.hostile import within_bytes

STORED, LZMA = zipfile.ZIP_STORED, zipfile.ZIP_LZMA


def zipped(
    files: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED, comment: bytes = b""
) -> bytes:
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", method) as archive:
        archive.comment = comment
        for name, data in files.items():
            archive.writestr(name, data)
    return made.getvalue()


def test_files_come_back_and_the_archive_is_always_the_same() -> None:
    files = {"a.txt": b"alpha", "empty": b""}
    data = encode_bundle(files)
    assert data == encode_bundle(files)
    for made in (data, zipped(files), zipped(files, STORED, b"a comment")):
        bundle = Bundle(made, "it")
        assert {name: bundle.read(name) for name in files} == files
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        assert archive.testzip() is None


def test_a_bomb_is_refused_by_what_it_claims() -> None:
    bomb = zipped({"zeros": bytes(64 << 20)})
    assert len(bomb) < 100_000
    with within_bytes(4 << 20):
        with pytest.raises(CorruptError, match="'zeros' claims 67108864 bytes"):
            Bundle(bomb, "it").read("zeros")
        # A file that lies about its size is truncated there.
        lying = bomb.replace((64 << 20).to_bytes(4, "little"), (9).to_bytes(4, "little"))
        with pytest.raises(CorruptError, match="is broken"):
            Bundle(lying, "it").read("zeros")


def encrypted() -> bytes:
    data = bytearray(zipped({"a": b"alpha"}))
    directory = data.index(b"PK\1\2")
    data[6] |= 1
    data[directory + 8] |= 1
    return bytes(data)


@pytest.mark.parametrize(
    ("data", "kind", "says"),
    [
        (b"PK\3\4", CorruptError, "ends inside the ZIP"),
        (zipped({"b": b""}), CorruptError, "'a' is not in the archive"),
        (encrypted(), UnsupportedError, "encrypted"),
        (zipped({"a": b"alpha"}, LZMA), UnsupportedError, "not read here"),
        (zipped({"a" * 60_000: b"", "b" * 60_000: b""}), CorruptError, "bytes of names"),
        (
            zipped({"a": b"alpha"}, zipfile.ZIP_STORED).replace(b"alpha", b"omega"),
            CorruptError,
            "broken",
        ),
    ],
)
def test_a_bad_archive_is_refused(data: bytes, kind: type[CodecError], says: str) -> None:
    with pytest.raises(kind, match=says):
        Bundle(data, "it").read("a")


def test_an_archive_of_more_than_4_gb_is_refused() -> None:
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as archive:
        for number in range(0x10000):
            archive.writestr(f"{number}", b"")
    with pytest.raises(UnsupportedError, match="4 GB"):
        Bundle(made.getvalue(), "it")
    assert len(made.getvalue()) > MAX_DIRECTORY_BYTES
