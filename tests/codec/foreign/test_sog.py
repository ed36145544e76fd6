"""SOG and its parts: archives, pictures, codebooks; axes, round trips and bombs."""

from __future__ import annotations

import io
import json
import struct
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from PIL import Image

from codec.arrays import Bytes
from codec.errors import CodecError, CorruptError, UnsupportedError
from codec.foreign.sog import MAX_DIRECTORY_BYTES, Bundle, decode_sog, encode_sog
from codec.foreign.webp import decode_webp, encode_webp, webp_size
from codec.interop.formats import ContainedFrame, contained_frames, decode_any, read_splats
from codec.sequence.importing import ImportOptions, import_stream
from codec.splats import Splats
from codec.stream import StreamReader
from tests.support.alike import largest_errors
from tests.support.commands import run_ok
from tests.support.drawn import angles_rad, drawn_splats, same_splats
from tests.support.hostile import refused, within_bytes
from tests.support.tiny_stream import write_tiny
from tests.support.trained_like import trained_like_splats

BOOK = [(i - 128) / 16 for i in range(256)]
PIXELS = {
    # Two Gaussians in the upper row, nothing in the lower.
    "ml": [[0, 255, 0], [255, 255, 255]],
    "mu": [[0, 255, 128], [255, 255, 255]],
    "s": [[128, 112, 0], [255, 144, 128]],
    "q": [[255, 128, 128, 252], [128, 255, 0, 255]],
    "c": [[128, 144, 112, 255], [0, 255, 128, 51]],
    "l": [[1, 0, 0], [0, 0, 0]],
}
META: dict[str, Any] = {
    "version": 2,
    "count": 2,
    "antialias": False,
    "means": {"mins": [-1, 0, -2], "maxs": [1, 3, 2], "files": ["ml", "mu"]},
    "scales": {"codebook": BOOK, "files": ["s"]},
    "quats": {"files": ["q"]},
    "sh0": {"codebook": BOOK, "files": ["c"]},
    "shN": {"count": 2, "bands": 1, "codebook": BOOK, "files": ["p", "l"]},
}


def webp(pixels: np.ndarray[Any, Any], **options: Any) -> bytes:
    file = io.BytesIO()
    lossless = {"lossless": True, "exact": True} | options
    Image.fromarray(pixels).save(file, "WEBP", **lossless)
    return file.getvalue()


def two_rows(pixels: list[list[int]]) -> bytes:
    table = np.zeros((2, 2, len(pixels[0])), np.uint8)
    table[0] = pixels
    return webp(table)


def files_of(meta: object) -> dict[str, bytes]:
    palette = np.zeros((1, 64 * 3, 3), np.uint8)
    palette[0, :6] = [[128, 128, 144]] * 3 + [[144, 128, 128], [128, 160, 128], [128, 128, 192]]
    pictures = {name: two_rows(pixels) for name, pixels in PIXELS.items()}
    return {"meta.json": json.dumps(meta).encode(), "p": webp(palette)} | pictures


def bundled(
    files: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED, comment: bytes = b""
) -> bytes:
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", method) as archive:
        archive.comment = comment
        for name, data in files.items():
            archive.writestr(name, data)
    return made.getvalue()


def changed(**parts: object) -> bytes:
    return bundled(files_of(META | parts))


def test_a_folder_of_these_files_is_the_same_model(tmp_path: Path) -> None:
    for name, data in files_of(META).items():
        (tmp_path / name).write_bytes(data)
    bundle = decode_any(bundled(files_of(META)))
    assert same_splats(read_splats(tmp_path), bundle)
    assert same_splats(read_splats(tmp_path / "meta.json"), bundle)
    refused(UnsupportedError, "2 Gaussians in a frame, at most 1", read_splats, tmp_path, 1)
    (tmp_path / "q").unlink()
    refused(CorruptError, "q is missing", read_splats, tmp_path)


@pytest.mark.parametrize("name", ["../q", "/etc/passwd", "a/b", "..", "", "C:\\q", "a\0b"])
def test_a_folder_gives_no_file_from_elsewhere(name: str, tmp_path: Path) -> None:
    meta = json.dumps(META | {"quats": {"files": [name]}})
    for other, data in files_of(META).items():
        (tmp_path / other).write_bytes(data)
    (tmp_path / "meta.json").write_text(meta)
    refused(UnsupportedError, "is not the name of a file beside", read_splats, tmp_path)


@given(drawn_splats(max_count=40))
@settings(max_examples=60, deadline=None)
def test_a_few_gaussians_lose_little(splats: Splats) -> None:
    """Sizes and colours with up to 256 different values are exact."""
    data = encode_sog(splats)
    assert data == encode_sog(splats)
    back = decode_any(data)
    assert len(back) == len(splats)
    if not len(splats):
        assert same_splats(back, Splats.empty())
        return
    assert back.sh.shape == splats.sh.shape
    logs = np.sign(splats.means) * np.log1p(np.abs(splats.means))
    nearest = np.abs(back.means[None] - splats.means[:, None]).max(axis=2).argmin(axis=1)
    if len(set(nearest)) < len(splats):
        return  # two Gaussians have the same place
    back = back.take(nearest)
    found = np.sign(back.means) * np.log1p(np.abs(back.means))
    assert np.abs(found - logs).max() <= 0.51 * np.ptp(logs, axis=0).max() / 65535 + 1e-6
    assert back.log_scales.tobytes() == splats.log_scales.tobytes()
    assert back.sh[:, 0].tobytes() == splats.sh[:, 0].tobytes()
    assert np.abs(back.opacities - splats.opacities).max() <= 0.51 / 255
    # Half a step of sqrt(2)/255 in three components; the fourth is at least as large as each.
    assert angles_rad(back, splats).max() <= np.sqrt(12) * np.sqrt(2) / 255


def test_many_gaussians_are_in_the_order_of_a_curve_through_space() -> None:
    """What they lose is measured in tests/player/test_formats_page.py."""
    splats = trained_like_splats(4000, 3, 1)
    steps = [
        np.linalg.norm(np.diff(s.means, axis=0), axis=1)
        for s in (splats, decode_sog(encode_sog(splats)))
    ]
    assert np.median(steps[1]) < 0.2 * np.median(steps[0])


@pytest.mark.parametrize(
    ("said", "says"),
    [
        ({"antialias": True}, "opacity compensation"),
        ({"antialias": False, "model": "antialiased"}, "opacity compensation"),
        ({"model": "2dgs"}, "2D Gaussians"),
        ({"model": "default"}, None),
    ],
)
def test_how_it_was_trained(
    said: dict[str, Any], says: str | None, caplog: pytest.LogCaptureFixture
) -> None:
    decode_sog(changed(**said))
    assert (says or "") in caplog.text
    assert len(caplog.messages) == (says is not None)


TSOG: dict[str, Any] = META | {
    "version": 4,
    "timeline": {"type": 1, "mins": [0, 0.1], "maxs": [1, 0.3], "files": ["ml", "mu"]},
    "temporal": {"means": {"mins": [[0, 0, 0]], "maxs": [[255, 255, 255]], "files": ["s"]}},
    "playback": {"duration": 2, "fps": 2},
}
DISCRETE = {"type": 0, "N": 3, "delta": 21845, "files": ["ml", "mu"]}


def tsog(path: Path, **parts: object) -> list[ContainedFrame]:
    path = path / "a.tsog"
    path.write_bytes(bundled(files_of(TSOG | parts)))
    return contained_frames(path) or []


def test_a_sequence_that_moves_and_fades(tmp_path: Path) -> None:
    frames = tsog(tmp_path, audio={"file": "a.mp3"})
    assert (len(frames), frames[0].reader.fps) == (5, 2)
    model, velocities = decode_any(bundled(files_of(META))), np.array(PIXELS["s"])
    for number, frame in enumerate(frames):
        since = number / 4 - np.array([0, 1])
        opacities = model.opacities * np.exp(-0.5 * (since / 0.3) ** 2)
        shown = opacities >= 1 / 255
        means = (model.means + since[:, None] * velocities) * [1, -1, -1]
        assert frame.read(9).means == pytest.approx(means[shown], rel=1e-5)
        assert frame.read(9).opacities == pytest.approx(opacities[shown], rel=1e-4)
    frames = tsog(tmp_path, timeline=DISCRETE, fps=7, playback={})
    assert frames[0].reader.fps == 7
    assert [len(frame.read(9)) for frame in frames] == [1, 0, 1]
    (tmp_path / "a.tsog").write_bytes(bundled(files_of(META | {"version": 4})))
    [still] = contained_frames(tmp_path / "a.tsog") or []
    assert len(still.read(9)) == 2
    refused(UnsupportedError, "frame 0: TSOG: 2 Gaussians in a frame, at most 1", still.read, 1)


def test_a_stream_there_and_back(tmp_path: Path) -> None:
    write_tiny(tmp_path / "stream", 6)
    run_ok("swings-stream", "export", tmp_path / "stream", tmp_path / "all.tsog")
    import_stream(tmp_path / "all.tsog", tmp_path / "back", ImportOptions())
    before, after = (StreamReader(tmp_path / name) for name in ("stream", "back"))
    assert (after.manifest.fps, after.num_frames) == (before.manifest.fps, 6)
    for frame in range(6):
        a, b = (r.active_splats(frame, r.manifest.num_layers) for r in (before, after))
        assert (largest_errors(b, a) < (1.5, 0.2, 0.15, 0.03, 0.06)).all()


@pytest.mark.parametrize(
    ("parts", "kind", "says"),
    [
        ({"version": 5}, UnsupportedError, "version 5; this program reads 4"),
        ({"profile": {"id": "other", "version": 1}}, UnsupportedError, "profile 'other' 1"),
        ({"timeline": DISCRETE | {"type": 2}}, UnsupportedError, "type 2"),
        ({"timeline": DISCRETE | {"delta": 9}}, CorruptError, "delta is not 65536 over N"),
        ({"timeline": TSOG["timeline"] | {"mins": [0, 0]}}, CorruptError, "sigma is not above 0"),
        ({"temporal": {"colour": {}}}, UnsupportedError, "moves 'colour'"),
        (
            {"scales": {"codebook": BOOK[:200], "files": ["s"]}},
            CorruptError,
            "a code of 255 of 200",
        ),
        ({"playback": {"duration": 1e300, "fps": 30}}, CorruptError, "1e.300 s at 30 frames"),
        ({"playback": {"duration": 1e6}}, CorruptError, "claims 30000001 frames"),
    ],
)
def test_a_bad_tsog_is_refused(
    parts: dict[str, object], kind: type[CodecError], says: str, tmp_path: Path
) -> None:
    refused(kind, rf"a\.tsog: .*{says}", tsog, tmp_path, **parts)


def without(name: str) -> bytes:
    return bundled({key: data for key, data in files_of(META).items() if key != name})


def replaced(name: str, data: bytes) -> bytes:
    return bundled(files_of(META) | {name: data})


WRONG_TAG = two_rows([[0, 0, 0, 252], [0, 0, 0, 251]])


@pytest.mark.parametrize(
    ("data", "kind", "says"),
    [
        (changed(version=1), UnsupportedError, "version 1; this program reads 2"),
        (bundled({"meta.json": b'{"means": {}}'}), UnsupportedError, "version 1"),
        (changed(version=True), CorruptError, "is not a whole number"),
        (changed(count=-1), CorruptError, "count: is not in 0"),
        (changed(count=5), CorruptError, "4 pixels of 5"),
        (changed(count=1 << 24), CorruptError, "claims to decompress to"),
        (changed(count=(1 << 24) + 1), CorruptError, "at most 16777216"),
        (changed(scales=7), CorruptError, "scales: is not an object"),
        (changed(scales={"codebook": BOOK[1:], "files": ["s"]}), CorruptError, "255 numbers"),
        (changed(scales={"codebook": BOOK, "files": ["s", "s"]}), CorruptError, "1 strings"),
        (changed(scales={"codebook": [1e300] * 256, "files": ["s"]}), CorruptError, "not finite"),
        (changed(sh0={"codebook": ["1"] * 256, "files": ["c"]}), CorruptError, "not a finite"),
        (changed(sh0={"codebook": [10**400] * 256, "files": ["c"]}), CorruptError, "out of range"),
        (changed(means=META["means"] | {"maxs": [1e9, 1, 1]}), CorruptError, "not finite"),
        (changed(shN=META["shN"] | {"count": 1}), CorruptError, "a label of 1 where"),
        (changed(shN=META["shN"] | {"count": 65}), CorruptError, "not 192 x 2 pixels"),
        (changed(shN=META["shN"] | {"bands": 2}), CorruptError, "not 512 x 1 pixels"),
        (changed(shN=META["shN"] | {"bands": 0}), CorruptError, "without harmonics"),
        (changed(shN=META["shN"] | {"bands": 4}), CorruptError, "bands: is not in 0..3"),
        (replaced("q", WRONG_TAG), CorruptError, "which component is left out"),
        (replaced("q", b"RIFF"), UnsupportedError, "'q': is not a WebP"),
        (replaced("meta.json", b"[]"), CorruptError, "not a JSON object"),
        (replaced("meta.json", b"{"), CorruptError, "is not JSON"),
        (replaced("meta.json", b"[" * 100_000), CorruptError, "is not JSON"),
        (replaced("meta.json", b" " * (5 << 20)), CorruptError, "meta.json' claims|bytes of JSON"),
        (without("ml"), CorruptError, "'ml' is not in the archive"),
        (without("meta.json"), CorruptError, "'meta.json' is not in the archive"),
    ],
)
def test_a_bad_sog_is_refused(data: bytes, kind: type[CodecError], says: str) -> None:
    refused(kind, says, decode_any, data)


def test_more_than_the_caller_takes_is_refused_before_a_picture_is_decoded() -> None:
    refused(UnsupportedError, "2 Gaussians in a frame, at most 1", decode_any, without("ml"), "", 1)


def test_a_huge_picture_costs_little_memory() -> None:
    """16000 x 16000 pixels of one colour take a few hundred bytes."""
    flat = webp(np.zeros((4000, 4000, 3), np.uint8), method=0)
    assert len(flat) < 20_000
    with within_bytes(4 << 20), pytest.raises(CorruptError, match="4000 x 4000 pixels, at most"):
        decode_any(replaced("ml", flat))


def test_a_bomb_is_refused_by_what_it_claims() -> None:
    bomb = bundled({"zeros": bytes(64 << 20)})
    assert len(bomb) < 100_000
    with within_bytes(4 << 20):
        refused(CorruptError, "'zeros' claims 67108864 bytes", Bundle(bomb, "it").read, "zeros")
        # A file that lies about its size is truncated there.
        lying = bomb.replace((64 << 20).to_bytes(4, "little"), (9).to_bytes(4, "little"))
        refused(CorruptError, "is broken", lambda: Bundle(lying, "it").read("zeros"))


def encrypted() -> bytes:
    data = bytearray(bundled({"a": b"alpha"}))
    directory = data.index(b"PK\1\2")
    data[6] |= 1
    data[directory + 8] |= 1
    return bytes(data)


@pytest.mark.parametrize(
    ("data", "kind", "says"),
    [
        (b"PK\3\4", CorruptError, "ends inside the ZIP"),
        (bundled({"b": b""}), CorruptError, "'a' is not in the archive"),
        (encrypted(), UnsupportedError, "encrypted"),
        (bundled({"a": b"alpha"}, zipfile.ZIP_LZMA), UnsupportedError, "not read here"),
        (bundled({"a" * 60_000: b"", "b" * 60_000: b""}), CorruptError, "bytes of names"),
        (
            bundled({"a": b"alpha"}, zipfile.ZIP_STORED).replace(b"alpha", b"omega"),
            CorruptError,
            "broken",
        ),
    ],
)
def test_a_bad_archive_is_refused(data: bytes, kind: type[CodecError], says: str) -> None:
    refused(kind, says, lambda: Bundle(data, "it").read("a"))


def test_an_archive_of_more_than_4_gb_is_refused() -> None:
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as archive:
        for number in range(0x10000):
            archive.writestr(f"{number}", b"")
    refused(UnsupportedError, "4 GB", Bundle, made.getvalue(), "it")
    assert len(made.getvalue()) > MAX_DIRECTORY_BYTES


def noise(*shape: int) -> Bytes:
    return np.random.default_rng(7).integers(0, 256, shape).astype(np.uint8)


@pytest.mark.parametrize("channels", [3, 4])
def test_every_byte_comes_back_also_of_what_is_transparent(channels: int) -> None:
    pixels = noise(5, 7, channels)
    if channels == 4:
        pixels[:3, :, 3] = 0
    data = encode_webp(pixels)
    assert webp_size(data, "it") == (7, 5)
    back = decode_webp(data, "it", 35)
    assert (back[..., :channels] == pixels).all()
    assert back.shape == (5, 7, 4)


def test_the_extended_layout_is_read() -> None:
    file = io.BytesIO()
    Image.fromarray(noise(4, 6, 3)).save(file, "WEBP", lossless=True, exif=b"Exif\0\0MM\0*")
    data = file.getvalue()
    assert data[12:16] == b"VP8X"
    assert webp_size(data, "it") == (6, 4)
    assert (decode_webp(data, "it", 24)[..., :3] == noise(4, 6, 3)).all()


def saved(format: str, **options: object) -> bytes:
    file = io.BytesIO()
    Image.fromarray(noise(4, 4, 3)).save(file, format, **options)
    return file.getvalue()


MOVING = saved(
    "WEBP", save_all=True, lossless=True, append_images=[Image.fromarray(noise(4, 4, 4)[..., :3])]
)


@pytest.mark.parametrize(
    ("data", "kind", "says"),
    [
        (b"", UnsupportedError, "it: is not a WebP"),
        (saved("PNG"), UnsupportedError, "is not a WebP"),
        (saved("WEBP"), UnsupportedError, "without loss"),
        (MOVING, UnsupportedError, "moving"),
        (encode_webp(noise(4, 4, 3))[:30], CorruptError, "broken"),
        (encode_webp(noise(3, 6, 3)), CorruptError, "6 x 3 pixels, at most 16"),
    ],
)
def test_another_picture_is_refused(data: bytes, kind: type[CodecError], says: str) -> None:
    refused(kind, says, decode_webp, data, "it", 16)


def test_a_side_that_no_decoder_takes_is_refused() -> None:
    head = b"RIFF" + struct.pack("<I", 100) + b"WEBPVP8X" + struct.pack("<I4x", 10)
    wide = head + b"\xff\xff\xff" + b"\0\0\0" + bytes(60)
    refused(CorruptError, "16777216 x 1 pixels", decode_webp, wide, "it", 1 << 40)
