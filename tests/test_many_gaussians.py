"""A stream of a few kilobytes whose manifest claims 2^24 Gaussians costs no memory unless its size
is allowed."""

from __future__ import annotations

import re
import sys
from contextlib import closing
from pathlib import Path

import pytest

import codec
from codec.errors import UnsupportedError
from codec.framerange import FrameRange
from codec.stream import StreamReader
from codec.stream.manifest import MANIFEST_NAME, Manifest
from codec.stream.reader import DEFAULT_MAX_GAUSSIANS
from player.script.openscene import Scene
from player.source.directory import DirectorySource
from player.source.opener import Opener
from tests.support.commands import run, run_ok
from tests.support.hosted_streams import served, static_host
from tests.support.slots.folder import slots_manifest, write_slots
from tests.support.slots.many import NUM_GAUSSIANS, write_many

LIMIT_BYTES = 200_000_000

REFUSAL = (
    r"16,777,216 Gaussians; use --max-gaussians 16777216 to read it \(about 4\.7 GB of memory\)"
)

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="memory is read from /proc")


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("library")
    write_many(folder / "many")
    return folder


def assert_refused(name: str, *words: object) -> None:
    done = run(name, *words, limits={"DATA": LIMIT_BYTES})
    assert done.returncode == 1, done.stderr
    assert re.fullmatch(rf"swings-\w+: \S+many\S* has {REFUSAL}\n", done.stderr), done.stderr


def test_it_is_small(library: Path) -> None:
    files = [path for path in library.rglob("*") if path.is_file()]
    assert sum(path.stat().st_size for path in files) < 10_000
    manifest = Manifest.from_json((library / "many" / MANIFEST_NAME).read_bytes())
    assert manifest.num_gs == NUM_GAUSSIANS == 4 * DEFAULT_MAX_GAUSSIANS


CPU = ("--renderer", "cpu")
REFUSED: tuple[tuple[str, ...], ...] = (
    ("swings-stream", "verify", "many"),
    ("swings-stream", "info", "many"),
    ("swings-stream", "export", "many", "out.ply", "--frame", "0"),
    ("swings-stream", "export", "many", "out.ply", "--frames", ":"),
    ("swings-stream", "export", "many", "out.ply", "--static"),
    ("swings-play", "many", "--capture", "out.mp4", *CPU),
    ("swings-play", "many", "--capture", "out.png", "--still", "0", *CPU),
    ("swings-play", "many", "--profile", "out.png", *CPU),
)


@pytest.mark.parametrize("words", REFUSED, ids=" ".join)
def test_it_is_refused(words: tuple[str, ...], library: Path, tmp_path: Path) -> None:
    folders = {"many": library, "out.": tmp_path}
    program, *rest = words
    assert_refused(program, *(folders[w[:4]] / w if w[:4] in folders else w for w in rest))
    assert not list(tmp_path.iterdir())


def test_playing_it_from_a_host_and_a_server(library: Path, tmp_path: Path) -> None:
    """The server decodes nothing, so it may serve the stream."""
    with static_host(library) as host, served(library) as server:
        for url in (f"{host}/many", f"{server.url}/watch/many"):
            assert_refused("swings-play", url, "--capture", tmp_path / "out.mp4", *CPU)
        status = Path(f"/proc/{server.process.pid}/status").read_text()
        (peak_kb,) = re.findall(r"VmHWM:\s+(\d+)", status)
        assert 1024 * int(peak_kb) < 2 * LIMIT_BYTES


def test_in_python(library: Path) -> None:
    many = library / "many"
    with closing(Opener(str(many))) as opener, closing(Opener(str(many))) as other:
        for refused in (
            lambda: codec.open_stream(many),
            lambda: Scene.open(many),
            lambda: opener.open(FrameRange(), None),
            lambda: other.preview(),
            lambda: DirectorySource(many, FrameRange(), None),
        ):
            with pytest.raises(UnsupportedError, match=REFUSAL):
                refused()


@pytest.mark.parametrize("most", [None, NUM_GAUSSIANS])
def test_a_size_that_is_allowed_opens(library: Path, most: int | None) -> None:
    many = library / "many"
    with codec.open_stream(many, max_gaussians=most) as stream:
        assert stream.manifest.num_gs == NUM_GAUSSIANS
    with Scene.open(many, max_gaussians=most) as scene:
        assert scene.num_frames == 1
    with closing(Opener(str(many), max_gaussians=most)) as opener:
        found = opener.preview()
        assert found is not None
        assert found.manifest.num_gs == NUM_GAUSSIANS
        with closing(opener.open(FrameRange(), None)) as source:
            assert source.num_frames == 1


def test_the_bound_is_the_number_that_is_given(tmp_path: Path) -> None:
    write_slots(tmp_path / "s", 6)
    count = slots_manifest().num_gs
    assert StreamReader(tmp_path / "s", count).num_frames == 6
    with pytest.raises(
        UnsupportedError, match=f"has {count} Gaussians; use --max-gaussians {count}"
    ):
        StreamReader(tmp_path / "s", count - 1)
    words = ("swings-stream", "verify", tmp_path / "s", "--max-gaussians")
    run_ok(*words, count)
    assert f"has {count} Gaussians" in run(*words, count - 1).stderr


def test_a_live_stream_that_grows_beyond_the_bound(library: Path, tmp_path: Path) -> None:
    write_slots(tmp_path / "s", 4)
    manifest = tmp_path / "s" / MANIFEST_NAME
    manifest.write_bytes(slots_manifest().to_json())
    reader = StreamReader(tmp_path / "s")
    manifest.write_bytes((library / "many" / MANIFEST_NAME).read_bytes())
    with pytest.raises(UnsupportedError, match=REFUSAL):
        reader.refresh()
