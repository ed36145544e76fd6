"""SOG of version 2 (PlayCanvas, "Spatially Ordered Gaussians"): meta.json and WebP pictures without
loss, one pixel a Gaussian, row after row; bundled in a ZIP, or, to be read only, in a folder.

    means     two pictures, the low and the high bytes of x, y, z in 16 bits between mins and maxs,
              each as sign(p) ln(1 + |p|)
    scales    RGB: which of the 256 values of a codebook ln s is, by axis
    quats     RGBA: A - 252 is which of w, x, y, z is largest and left out; the other three in
              order, as (v / 255 - 1/2) * sqrt(2)
    sh0       RGBA: which of the 256 values of a codebook f_dc is, by channel; opacity of 255
    shN       labels: R + 256 G is which row of a palette holds the other harmonics.
              centroids: 64 rows of the palette in a row of pixels, K - 1 pixels each, RGB: which of
              the 256 values of a codebook it is

The specification (developer.playcanvas.com) says that y points up, and that the first mode leaves
out x; the programs that write and read these files keep the frame of the PLY, RDF, and w first. So
do these functions.

A codebook has few values, or few rows of values, that stand for many; the same input always gives
the same book. A ZIP archive (PKWARE's APPNOTE) is stored or deflated, and of bounded size.
"""

from __future__ import annotations

import io
import json
import struct
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from codec.arrays import Bytes, Doubles, Floats, Longs
from codec.errors import CorruptError, UnsupportedError
from codec.kernel import kernel
from codec.lattice.forms import interleave
from codec.splats import MAX_SH_DEGREE, Splats, sh_count

from .bounds import (
    MAX_GAUSSIANS,
    Decoded,
    byte_logits,
    check_count,
    check_ratio,
    clipped_bytes,
    opacity_bytes,
    restore_largest,
    split_largest,
    unit_quats,
)
from .jsonfields import Fields
from .modelfolder import Files, ModelFolder
from .notes import ANTIALIASED, tell_model
from .webp import decode_webp, encode_webp

CODES = 256
MAX_ROUNDS = 60
"""Rounds of Lloyd's iteration, which moves little after twenty."""


def codebook(values: Floats) -> Floats:
    """(256,) ascending values of which the nearest stands for each of `values`.

    What has no more different values is kept exactly. Else Lloyd's iteration (S. Lloyd, "Least
    squares quantization in PCM", 1982) from a start that is half quantiles, where most values lie,
    and half even steps, so that none is far away.
    """
    ordered = np.sort(values.ravel()).astype(np.float64)
    different = ordered[np.flatnonzero(np.diff(ordered, prepend=np.nan) != 0)]
    if len(different) <= CODES:
        last = different[-1:] if len(different) else np.zeros(1)
        return np.append(different, np.repeat(last, CODES - len(different))).astype(np.float32)
    half = (np.arange(CODES // 2) + 0.5) / (CODES // 2)
    even = ordered[0] + half * (ordered[-1] - ordered[0])
    book: Doubles = np.sort(np.append(ordered[(half * len(ordered)).astype(np.int64)], even))
    sums = np.append(0.0, np.cumsum(ordered))
    before = np.empty(0, np.intp)
    for _ in range(MAX_ROUNDS):
        ends = np.searchsorted(ordered, _middles(book))
        if np.array_equal(ends, before):
            break
        before = ends
        bounds = np.concatenate(([0], ends, [len(ordered)]))
        counts = np.diff(bounds)
        book = np.where(counts > 0, np.diff(sums[bounds]) / np.maximum(counts, 1), book)
    return np.sort(book.astype(np.float32))


def _middles(book: Doubles) -> Doubles:
    middles: Doubles = (book[1:] + book[:-1]) / 2
    return middles


def codes_of(values: Floats, book: Floats) -> Bytes:
    """Which of the ascending `book` is nearest to each of `values`; the shape of `values`."""
    codes: Bytes = np.searchsorted(_middles(book.astype(np.float64)), values).astype(np.uint8)
    return codes


@kernel(nogil=True)
def _spread_of(values, labels, counts, means, squares):  # type: ignore[no-untyped-def]
    """Fills counts (k,), means (k, D) and the summed squares around them (k, D), which begin as
    zeros, of the rows with each label."""
    for i in range(values.shape[0]):
        counts[labels[i]] += 1
        for d in range(values.shape[1]):
            means[labels[i], d] += values[i, d]
    for j in range(means.shape[0]):
        for d in range(means.shape[1]):
            means[j, d] /= max(counts[j], 1)
    for i in range(values.shape[0]):
        for d in range(values.shape[1]):
            away = values[i, d] - means[labels[i], d]
            squares[labels[i], d] += away * away


def palette(rows: Floats, size: int) -> tuple[Floats, Longs]:
    """(k, D) rows, k at most `size`, and (N,) which of them stands for each of the (N, D) `rows`.

    A tree: in each round the half of the groups that spread most are cut in two, across the axis on
    which they spread most and at their mean. It takes about log_1.5(size) rounds over all rows,
    where nearest-centre clustering would look at every pair. Groups are numbered by their first
    row. Rows that are alike share a group.
    """
    labels = np.zeros(len(rows), np.int64)
    count = 1
    while True:
        counts = np.zeros(count, np.int64)
        means, squares = np.zeros((2, count, rows.shape[1]))
        _spread_of(rows, labels, counts, means, squares)
        spread = squares.sum(axis=1)
        room = min(size - count, (count + 1) // 2)
        worst = np.argsort(-spread, kind="stable")[:room]
        worst = worst[spread[worst] > 0]
        if not len(worst):
            break
        child = np.full(count, -1)
        child[worst] = count + np.arange(len(worst))
        axis = squares.argmax(axis=1)
        above = rows[np.arange(len(rows)), axis[labels]] > means[labels, axis[labels]]
        labels = np.where(above & (child[labels] >= 0), child[labels], labels)
        count += len(worst)
    used, first = np.unique(labels, return_index=True)
    order = used[np.argsort(first)]
    rank = np.zeros(count, np.int64)
    rank[order] = np.arange(len(order))
    return means[order].astype(np.float32), rank[labels]


MAGIC = b"PK\3\4"
END = struct.Struct("<4s4H2IH")
END_MAGIC, LONG_MAGIC = b"PK\5\6", b"PK\6\7"
LONG_BYTES = 20
"""Size of the record before the end that points to a longer one, for more than 4 GB."""
MAX_COMMENT_BYTES = 0xFFFF
MAX_DIRECTORY_BYTES = 1 << 16
"""Largest table of contents. That of a few files has less than a kilobyte; every 46 bytes become a
Python object."""
FILE_SLACK_BYTES = 1 << 20
"""By how much a file may be longer than the archive: only text shrinks much."""
_BROKEN = (
    *(zipfile.BadZipFile, zipfile.LargeZipFile, zlib.error, struct.error),
    *(OSError, EOFError, ValueError, RuntimeError, LookupError),
)


class Bundle:
    """The archive `data`, called `what` in errors."""

    def __init__(self, data: bytes, what: str) -> None:
        """Raises CorruptError, or UnsupportedError."""
        self._what = what
        self.num_bytes = len(data)
        """Size of the archive."""
        self._max_bytes = len(data) + FILE_SLACK_BYTES
        _check_end(data, what)
        try:
            self._archive = zipfile.ZipFile(io.BytesIO(data))
        except _BROKEN as error:
            raise CorruptError(f"{what}: the ZIP archive is broken: {error}") from error

    def read(self, name: str) -> bytes:
        """The file called `name`. Raises CorruptError, or UnsupportedError."""
        shown = f"{self._what}: {name[:40]!r}"
        try:
            info = self._archive.getinfo(name)
        except KeyError as error:
            raise CorruptError(f"{shown} is not in the archive") from error
        if info.flag_bits & 1 or info.compress_type not in (
            zipfile.ZIP_STORED,
            zipfile.ZIP_DEFLATED,
        ):
            raise UnsupportedError(f"{shown} is encrypted, or packed in a way not read here")
        if info.file_size > self._max_bytes:
            raise CorruptError(f"{shown} claims {info.file_size} bytes, at most {self._max_bytes}")
        try:
            with self._archive.open(info) as file:
                return file.read(self._max_bytes)
        except _BROKEN as error:
            raise CorruptError(f"{shown} is broken: {error}") from error


def _check_end(data: bytes, what: str) -> None:
    """Raises an error for an archive whose table of contents is too long to be looked at."""
    # As zipfile looks for it: at the very end, else before a comment.
    at = len(data) - END.size
    if at < 0 or data[at : at + 4] != END_MAGIC or data[-2:] != b"\0\0":
        at = data.rfind(END_MAGIC, max(0, len(data) - END.size - MAX_COMMENT_BYTES))
    if at < 0 or len(data) < at + END.size:
        raise CorruptError(f"{what}: ends inside the ZIP archive")
    if data[max(0, at - LONG_BYTES) : at].startswith(LONG_MAGIC):
        raise UnsupportedError(f"{what}: a ZIP archive with records for more than 4 GB")
    directory_bytes = END.unpack_from(data, at)[5]
    if directory_bytes > MAX_DIRECTORY_BYTES:
        raise CorruptError(
            f"{what}: {directory_bytes} bytes of names in the ZIP archive, "
            f"at most {MAX_DIRECTORY_BYTES}"
        )


def encode_bundle(files: Mapping[str, bytes]) -> bytes:
    """The archive of `files`, stored as they are; the same bytes whenever it is made."""
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w") as archive:
        for name, data in files.items():
            info = zipfile.ZipInfo(name)  # of the first day that ZIP knows
            info.create_system = 3
            info.external_attr = 0o644 << 16
            archive.writestr(info, data)
    return made.getvalue()


META = "meta.json"
VERSION = 2
FIRST_MODE = 252
LEVELS = 65535
"""Steps of a position."""
MAX_PALETTE = 1 << 16
PALETTE_COLUMNS = 64
PIXEL_BYTES = 20
"""Size of a Gaussian in the five decoded pictures that are always there."""
SPARE_PIXELS = 1 << 16


class Pictures:
    """The pictures among `files` with a pixel for each of `count` Gaussians; `what` is for
    errors."""

    def __init__(self, files: Files, count: int, what: str = "SOG") -> None:
        self._files, self._count, self.what = files, count, what

    def pixels(self, name: str, needed: int) -> Bytes:
        """(height, width, 4) of a picture that is not much larger than `needed` pixels."""
        most = 2 * needed + SPARE_PIXELS
        return decode_webp(self._files.read(name), f"{self.what}: {name[:40]!r}", most)

    def rows(self, name: str) -> Bytes:
        """(N, 4): a pixel for each Gaussian."""
        pixels = self.pixels(name, self._count).reshape(-1, 4)
        if len(pixels) < self._count:
            raise CorruptError(f"{self.what}: {name[:40]!r}: {len(pixels)} pixels of {self._count}")
        return pixels[: self._count]

    def shorts(self, names: Sequence[str]) -> npt.NDArray[np.uint16]:
        """(N, 4): numbers of which two pictures hold the low and the high bytes."""
        low, high = (self.rows(name) for name in names)
        return low | high.astype(np.uint16) << np.uint16(8)


def _book(fields: Fields, codes: Bytes, least: int) -> Floats:
    """The codebook of `fields`, in which all `codes` are. least: its least length."""
    with np.errstate(over="ignore"):  # infinities are refused with the Gaussians that have them
        book = np.array(fields.numbers("codebook", CODES, least=least)).astype(np.float32)
    if codes.max(initial=0) >= len(book):
        raise CorruptError(f"{fields.where}: a code of {codes.max()} of {len(book)}")
    return book


def _harmonics(
    shn: Fields, pictures: Pictures, least: int
) -> tuple[int, Floats, npt.NDArray[np.uint16]]:
    """The SH degree, (k, K - 1, 3) the palette, and (N,) which row of it each Gaussian has."""
    what = pictures.what
    degree = shn.integer("bands", most=MAX_SH_DEGREE)
    size = shn.integer("count", most=MAX_PALETTE)
    if not degree or not size:
        raise CorruptError(f"{what}: shN without harmonics")
    coefficients = sh_count(degree) - 1
    names = shn.texts("files", 2)
    width, height = PALETTE_COLUMNS * coefficients, -(-size // PALETTE_COLUMNS)
    pixels = pictures.pixels(names[0], width * height)
    if pixels.shape[1] != width or pixels.shape[0] < height:
        raise CorruptError(f"{what}: {names[0][:40]!r}: not {width} x {height} pixels")
    entries = pixels[..., :3].reshape(-1, coefficients, 3)[:size]
    rows = pictures.rows(names[1])
    labels = rows[:, 0] | rows[:, 1].astype(np.uint16) << np.uint16(8)
    if labels.max(initial=0) >= size:
        raise CorruptError(f"{what}: a label of {labels.max()} where the palette has {size} rows")
    return degree, _book(shn, entries, least)[entries], labels


def decode_sog(data: bytes, max_gaussians: int = MAX_GAUSSIANS) -> Splats:
    """The Gaussians of a bundled SOG of version 2.

    Raises CorruptError, or UnsupportedError, also for more than `max_gaussians`.
    """
    return _decode(Bundle(data, "SOG"), max_gaussians)


def decode_sog_folder(path: Path, max_gaussians: int = MAX_GAUSSIANS) -> Splats:
    """The Gaussians of a SOG of version 2 whose files lie in the folder `path`. Raises as
    `decode_sog` does."""
    return _decode(ModelFolder(path, "SOG"), max_gaussians)


def is_sog_folder(path: Path) -> bool:
    """Whether `path` is a folder with what a SOG begins with."""
    return (path / META).is_file()


def _decode(files: Files, max_gaussians: int) -> Splats:
    meta = Fields.parse(files.read(META), f"SOG: {META}")
    version = meta.integer("version", 1, most=1 << 32)
    if version != VERSION:
        raise UnsupportedError(f"SOG: version {version}; this program reads {VERSION}")
    count = check_count("SOG", meta.integer("count", most=1 << 53), max_gaussians)
    check_ratio("SOG", count * PIXEL_BYTES, files.num_bytes)
    tell_model(meta.text("model", ANTIALIASED if meta.flag("antialias") else ""))
    return decode_attributes(meta, Pictures(files, count), count).checked("SOG")


def decode_attributes(
    meta: Fields, pictures: Pictures, count: int, least_book: int = CODES
) -> Decoded:
    """The `count` Gaussians of the `pictures` that `meta` names, in the axes of the file; what is
    not finite is still among them. least_book: least length of a codebook. Raises a CodecError."""
    degree, entries, labels = 0, np.empty((0, 0, 3), np.float32), np.empty(0, np.uint16)
    if "shN" in meta:
        degree, entries, labels = _harmonics(meta.fields("shN"), pictures, least_book)
    means, scales, sh0 = (meta.fields(name) for name in ("means", "scales", "sh0"))
    steps = pictures.shorts(means.texts("files", 2))[:, :3]
    scale_rows, quat_rows, sh0_rows = (
        pictures.rows(fields.texts("files", 1)[0]) for fields in (scales, meta.fields("quats"), sh0)
    )
    lower, upper = np.array(means.numbers("mins", 3)), np.array(means.numbers("maxs", 3))
    scale_book = _book(scales, scale_rows[:, :3], least_book)
    sh0_book = _book(sh0, sh0_rows[:, :3], least_book)
    if quat_rows[:, 3].min(initial=FIRST_MODE) < FIRST_MODE:
        what = pictures.what
        raise CorruptError(f"{what}: a quaternion does not say which component is left out")
    made = Decoded.empty(count, degree)
    for block in made.blocks():
        three = (quat_rows[block, :3] / 255 - 0.5) * np.sqrt(2.0)
        with np.errstate(all="ignore"):  # infinities and NaN are refused below
            logs = lower + (upper - lower) * (steps[block] / LEVELS)
            made.means[block] = np.sign(logs) * np.expm1(np.abs(logs))
        made.log_scales[block] = scale_book[scale_rows[block, :3]]
        made.quats[block] = restore_largest(three, quat_rows[block, 3] - FIRST_MODE)
        made.logit_opacities[block] = byte_logits(sh0_rows[block, 3])
        made.sh[block, 0] = sh0_book[sh0_rows[block, :3]]
        if degree:
            made.sh[block, 1:] = entries[labels[block]]
    return made


def _quantised_means(means: Floats) -> tuple[npt.NDArray[np.uint16], Doubles, Doubles]:
    """(N, 3) steps, and (3,) what the first and the last stand for."""
    wide = means.astype(np.float64)
    logs = np.sign(wide) * np.log1p(np.abs(wide))
    if not len(logs):
        return np.zeros((0, 3), np.uint16), np.zeros(3), np.zeros(3)
    lower, upper = logs.min(axis=0), logs.max(axis=0)
    shares = (logs - lower) / np.where(upper > lower, upper - lower, 1)
    return np.rint(shares * LEVELS).astype(np.uint16), lower, upper


def _numbers(values: Floats) -> list[float]:
    """`values` as JSON keeps them, as short as a float32 can be written."""
    return [float(str(value)) for value in values]


class Sheet:
    """Tables of bytes as pictures with a pixel for each of `count` rows."""

    def __init__(self, count: int) -> None:
        # Multiples of four, which graphics hardware likes.
        self.width = max(4, int(np.ceil(np.sqrt(count) / 4)) * 4)
        self.height = max(4, -(-count // self.width // 4) * 4)

    def picture(self, *columns: Bytes) -> bytes:
        """columns: (N, any) bytes, together three or four channels."""
        rows = np.concatenate(columns, axis=1)
        pixels = np.zeros((self.width * self.height, rows.shape[1]), np.uint8)
        pixels[: len(rows)] = rows
        return encode_webp(pixels.reshape(self.height, self.width, -1))


def low_and_high(values: npt.NDArray[np.integer]) -> tuple[Bytes, Bytes]:
    return (values & 255).astype(np.uint8), (values >> 8).astype(np.uint8)


def _encode_harmonics(
    rest: Floats, sh_degree: int, sheet: Sheet
) -> tuple[dict[str, Any], dict[str, bytes]]:
    """Entries of meta.json for (N, K - 1, 3) harmonics, and their pictures."""
    count, coefficients, _ = rest.shape
    # As many rows as the largest power of two of Gaussians that there are.
    size = min(MAX_PALETTE, 1 << count.bit_length() - 1)
    entries, labels = palette(rest.reshape(count, -1), size)
    book = codebook(entries)
    rows_of_pixels = -(-len(entries) // PALETTE_COLUMNS)
    pixels = np.zeros((rows_of_pixels * PALETTE_COLUMNS, coefficients * 3), np.uint8)
    pixels[: len(entries)] = codes_of(entries, book)
    low, high = low_and_high(labels[:, None])
    files = {
        "shN_centroids.webp": encode_webp(
            pixels.reshape(rows_of_pixels, PALETTE_COLUMNS * coefficients, 3)
        ),
        "shN_labels.webp": sheet.picture(low, high, np.zeros_like(low)),
    }
    about = {"count": len(entries), "bands": sh_degree, "codebook": _numbers(book)}
    return about, files


def encode_sog(splats: Splats) -> bytes:
    """The bundled SOG of `splats`, in the order of a Morton curve. Nothing is clipped."""
    attributes, files, _ = encode_attributes(splats)
    meta = {"version": VERSION, "count": len(splats), "antialias": False} | attributes
    return encode_bundle({META: json_bytes(meta)} | files)


def json_bytes(meta: dict[str, Any]) -> bytes:
    """The text of `meta`."""
    return json.dumps(meta, separators=(",", ":"), allow_nan=False).encode()


def encode_attributes(
    splats: Splats,
) -> tuple[dict[str, Any], dict[str, bytes], npt.NDArray[np.intp]]:
    """What meta.json says of the attributes of `splats`, their pictures, and the order in which
    these have the Gaussians: that of a Morton curve."""
    steps, lower, upper = _quantised_means(splats.means)
    order = np.argsort(interleave(steps.astype(np.int64)), kind="stable")
    splats, steps = splats.take(order), steps[order]
    sheet = Sheet(len(splats))
    low, high = low_and_high(steps)
    largest, three = split_largest(unit_quats(splats.quats))
    scale_book, sh0_book = codebook(splats.log_scales), codebook(splats.sh[:, 0])
    files = {
        "means_l.webp": sheet.picture(low),
        "means_u.webp": sheet.picture(high),
        "scales.webp": sheet.picture(codes_of(splats.log_scales, scale_book)),
        "quats.webp": sheet.picture(
            clipped_bytes((three / np.sqrt(2) + 0.5) * 255),
            (FIRST_MODE + largest[:, None]).astype(np.uint8),
        ),
        "sh0.webp": sheet.picture(
            codes_of(splats.sh[:, 0], sh0_book), opacity_bytes(splats.opacities)[:, None]
        ),
    }
    meta: dict[str, Any] = {
        "means": {
            "mins": lower.tolist(),
            "maxs": upper.tolist(),
            "files": ["means_l.webp", "means_u.webp"],
        },
        "scales": {"codebook": _numbers(scale_book), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": _numbers(sh0_book), "files": ["sh0.webp"]},
    }
    if splats.sh_degree and len(splats):
        about, pictures = _encode_harmonics(splats.sh[:, 1:], splats.sh_degree, sheet)
        meta["shN"] = about | {"files": list(pictures)}
        files |= pictures
    return meta, files, order
