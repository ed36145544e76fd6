"""A stream for plain web servers: a finished copy of it, with a page that plays it.

Everything lies at a fixed relative path, and each file is fetched whole: no ranges, no logic.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from html import escape
from importlib.util import find_spec
from pathlib import Path

from codec.edit.segmentfiles import SegmentFiles
from codec.errors import InvalidError
from codec.files import making_folder, write_atomic
from codec.storage.openstorage import Place
from codec.stream.manifest import Manifest
from codec.stream.packedlayout import PACKED_SUFFIX
from codec.stream.pictures import read_picture
from codec.stream.reader import DEFAULT_MAX_GAUSSIANS, StreamReader
from codec.tracks.streamtracks import copy_tracks

from .audit import verify_objects


@dataclass(frozen=True, slots=True)
class StaticExport:
    """The files that `export_static` wrote."""

    num_frames: int
    num_segments: int
    objects_bytes: int


def export_static(
    stream: Place,
    out: Path,
    max_gaussians: int | None = DEFAULT_MAX_GAUSSIANS,
    page: bool = False,
) -> StaticExport:
    """Writes the stream at `stream` to the folder `out`, absent or empty.

    Every chunk is decoded and checked on the way; the objects stay as they are. A live stream is
    exported as far as it has come, and finished. `out` appears whole or not at all. page: also
    writes a page with the browser player, see `write_page`. max_gaussians: see `check_gaussians`.
    Raises a SwingsError that names the file at fault.
    """
    if out.name.endswith(PACKED_SUFFIX):
        raise InvalidError(f"{out}: --static writes a folder; swings-stream pack writes one file")
    reader = StreamReader(stream, max_gaussians)
    if not reader.records:
        raise InvalidError(f"{reader.name} has no frames yet; there is nothing to export")
    with making_folder(out) as folder:
        files = SegmentFiles(folder, reader.manifest)
        verify_objects(reader)
        for record in reader.records:
            objects = {
                part: reader.read_object(record.segment, part).data
                for part in reader.manifest.parts
            }
            files.add(objects, record.num_frames, record.psnr_db)
        files.finish()
        _copy_pictures(reader, folder)
        copy_tracks(reader, folder)
        if page:
            write_page(folder, reader.manifest)
    return StaticExport(reader.num_frames, files.num_segments, files.size_bytes)


def _copy_pictures(reader: StreamReader, folder: Path) -> None:
    """Takes the poster and the storyboard along, if they lie in the stream's folder."""
    for path in (reader.manifest.poster, reader.manifest.storyboard):
        content = read_picture(reader.storage, path)
        if content is not None and path is not None:
            copy = folder / path
            copy.parent.mkdir(parents=True, exist_ok=True)
            write_atomic(copy, content)


PAGE_NAME, PLAYER_FOLDER = "index.html", "player"
FOR_PAGES = ("page.js", "watch.html", "manifest.json")
"""Files of the bundle that a page is made of."""
TITLE, PLACE = "<title>swings</title>", '="./'
"""Text of the bundle's page that an export replaces."""


def write_page(folder: Path, manifest: Manifest) -> None:
    """Puts PAGE_NAME and PLAYER_FOLDER into the `folder` of a stream, which the page plays. Raises
    InvalidError where the browser player is not installed."""
    bundle = _bundle()
    page = (bundle / "watch.html").read_text(encoding="utf-8")
    title = escape(manifest.title or "swings")
    head = f'<title>{title}</title>\n    <meta property="og:title" content="{title}" />'
    if manifest.sh_degree >= 2:
        harmonics = json.loads((bundle / "manifest.json").read_bytes())["harmonics"]
        head += f'\n    <link rel="modulepreload" href="./{harmonics}" />'
    page = page.replace(TITLE, head, 1).replace(PLACE, f"{PLACE}{PLAYER_FOLDER}/")
    (folder / PLAYER_FOLDER).mkdir()
    for path in sorted(bundle.iterdir()):
        if path.name not in FOR_PAGES and path.suffix != ".map":
            write_atomic(folder / PLAYER_FOLDER / path.name, path.read_bytes())
    write_atomic(folder / PAGE_NAME, page.encode())


def _bundle() -> Path:
    # By its name: the codec does not import the player.
    spec = find_spec("player")
    for place in spec.submodule_search_locations or () if spec is not None else ():
        folder = Path(place) / "web" / "bundle"
        if (folder / "watch.html").is_file():
            return folder
    raise InvalidError("--page: the browser player is not installed; reinstall swings")
