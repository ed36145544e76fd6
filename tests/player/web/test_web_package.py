"""The npm package: packed, bundled, and played by other engines."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import tarfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from codec.stream.reader import StreamReader
from codec.tools.static import export_static
from player.render.cpu import render_splats
from player.render.project import ALPHA_MIN
from tests.support.hosted_streams import static_host, write_stream
from tests.support.waiting import wait_until
from tests.support.web.canvas import psnr_db
from tests.support.web.chromium import Page, why_not
from tests.support.web.nodeprocess import NODE, PACKAGES

ROOT = Path(__file__).parents[3]
EXAMPLE_HOST = "https://streams.example.com"
NUM_FRAMES = 30


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project folder with the packed package in node_modules, but for its declarations, which
    `npm test` checks."""
    if why_not() is not None:
        pytest.skip(f"{why_not()}")
    path = tmp_path_factory.mktemp("project")
    npm = shutil.which("npm")
    assert NODE is not None
    assert npm is not None
    packing = [npm, "pack", "--ignore-scripts", "--silent", "--pack-destination", str(path)]
    for command in ([NODE, "tools/dist.js", "--untyped"], packing):
        subprocess.run(command, cwd=PACKAGES.parent, check=True, capture_output=True)
    with tarfile.open(next(path.glob("*.tgz"))) as packed:
        packed.extractall(path / "unpacked", filter="data")
    (path / "npm").mkdir()
    shutil.move(path / "unpacked" / "package", path / "npm" / "swings-player")
    for name in ("@sparkjsdev", "playcanvas", "three"):
        (path / "npm" / name).symlink_to(PACKAGES / name)
    (path / "node_modules").symlink_to("npm")
    return path


@pytest.fixture(scope="module")
def host(installed: Path) -> Iterator[str]:
    """Serves that folder with streams of one layer: stream/, and harmonics/ of degree 1."""
    # One layer, because the arrival of others depends on the link.
    for name, sh_degree in (("stream", 0), ("harmonics", 1)):
        write_stream(installed / f"{name}-trained", NUM_FRAMES, 150, sh_degree, layers=(1.0,))
        export_static(installed / f"{name}-trained", installed / name)
    with static_host(installed) as url:
        yield url


def test_it_has_what_its_description_names(installed: Path) -> None:
    package = installed / "npm" / "swings-player"
    description = json.loads((package / "package.json").read_text(encoding="utf-8"))
    assert f'version = "{description["version"]}"' in (ROOT / "pyproject.toml").read_text()
    for name, targets in description["exports"].items():
        module = targets["default"] if isinstance(targets, dict) else targets
        assert "*" in name or (package / module).is_file(), name
    assert {path.name for path in (package / "dist" / "workers").glob("*.js")} == {
        *("feedworker.js", "playworker.js", "sortworker.js")
    }
    # Nothing from the tests, nothing from three.js and other engines.
    assert sum(path.stat().st_size for path in package.rglob("*.js")) < 2_000_000


CORE = """
import { Fetcher, openSource, PlaySession, Scene } from "swings-player/core";

const nowS = () => performance.now() / 1000;
const stream = await openSource(process.argv[2], new Fetcher());
const { manifest } = stream;
const play = stream.play({ firstFrame: 7, mostLayers: manifest.numLayers, nowS });
const round = new PlaySession(stream, play, 7, manifest.numLayers, 1);
const scene = new Scene(manifest.numGs, manifest.shDegree, manifest.layout.lattices);
let shown = null;
while (shown === null) {
  play.step();
  if (round.failure) throw round.failure;
  shown = round.playback.tick(nowS());
  await new Promise((resolve) => setTimeout(resolve, 20));
}
round.close();
scene.put(shown);
const { frame, slots, gaussians } = scene.take();
console.log(JSON.stringify({ frame, count: slots.length, x: gaussians.means[0] }));
"""


def test_its_core_reads_a_stream_without_a_page(installed: Path, host: str) -> None:
    assert NODE is not None
    (installed / "core.mjs").write_text(CORE, encoding="utf-8")
    command = [NODE, "core.mjs", f"{host}/stream/"]
    done = subprocess.run(command, cwd=installed, capture_output=True, text=True, timeout=60)
    assert done.stderr == ""
    found = json.loads(done.stdout)
    splats = StreamReader(installed / "stream-trained").active_splats(7, 1)
    # Invisible Gaussians are not passed on.
    visible = 1 / (1 + np.exp(-splats.logit_opacities)) >= ALPHA_MIN
    assert (found["frame"], found["count"]) == (7, visible.sum())
    assert np.float32(found["x"]) in splats.means[:, 0]


PAGE = '<!doctype html><link rel="icon" href="data:," />'


def test_it_plays_from_a_bundle(page: Page, installed: Path, host: str) -> None:
    """esbuild does not change the workers' URLs: they are beside the bundle's folder."""
    (installed / "page.js").write_text('import "swings-player";', encoding="utf-8")
    command = [str(PACKAGES / ".bin" / "esbuild"), "page.js", "--bundle", "--format=esm"]
    subprocess.run([*command, "--outdir=built/app", "--log-level=error"], cwd=installed, check=True)
    workers = installed / "npm" / "swings-player" / "dist" / "workers"
    shutil.copytree(workers, installed / "built" / "workers")
    (installed / "bundled.html").write_text(
        f'{PAGE}<script type="module" src="built/app/page.js"></script>'
        '<swings-player src="stream" autoplay></swings-player>'
    )
    page.open(f"{host}/bundled.html", 160, 120)
    page.wait("element.ended")


def test_a_second_copy_only_warns(page: Page, installed: Path, host: str) -> None:
    """The package runs unbundled from a plain server, beside the player of another folder."""
    (installed / "other").symlink_to(ROOT / "player" / "web" / "bundle")
    (installed / "twice.html").write_text(
        f'{PAGE}<script type="module" src="npm/swings-player/dist/element/swingsplayer.js">'
        '</script><script type="module" src="other/player.js"></script>'
        '<swings-player src="stream" autoplay></swings-player>'
    )
    page.open(f"{host}/twice.html", 160, 120)
    page.wait("element.currentTime > 0.1")
    (complaint,) = page.take_complaints()
    version = page.value("element.constructor.version")
    assert complaint == (
        f"swings-player {version} was loaded where {version} already is <swings-player>; "
        "the first one stays"
    )


def open_example(page: Page, installed: Path, host: str, name: str, stream: str) -> None:
    """Opens an example in a page of 320 by 240, whose playing object is its `window.kept`."""
    text = (ROOT / "examples" / f"{name}.html").read_text(encoding="utf-8")
    (script,) = re.findall(r'<script type="module">\n(.*?) *</script>', text, re.DOTALL)
    kept, _, most_lines = ENGINES[name]
    assert script.count("\n") <= most_lines
    text = text.replace(script, f"{script}window.kept = {kept};")
    text = text.replace(f"{EXAMPLE_HOST}/stream", f"{host}/{stream}").replace(EXAMPLE_HOST, host)
    (installed / f"{name}.html").write_text(text, encoding="utf-8")
    page.open(f"{host}/{name}.html", 320, 240)


ENGINES = {
    "spark": ("mesh", "kept.video.paused && kept.video.loop && kept.currentTime === 0.5", 10),
    "playcanvas": ("feed", "kept.frame === 15 && !kept.isSeeking", 80),
}
"""For each example the variable with the playing object, what is true of it half a second from the
start, and the most lines of its script."""


@pytest.mark.parametrize(
    ("name", "stream", "least_psnr_db"),
    [("spark", "stream", 48.0), ("spark", "harmonics", 27.0), ("playcanvas", "stream", 35.0)],
)
def test_an_engine_plays_it(
    page: Page, installed: Path, host: str, name: str, stream: str, least_psnr_db: float
) -> None:
    """The picture of an example is that of the CPU renderer, as far as the engine's recipe allows.

    Spark: 52.7 dB, and 28.1 with random harmonics, whose colours exceed 0..1 much more than trained
    ones. PlayCanvas: 36.9, because it cuts Gaussians off at 2.83 sigma and blurs them less.
    """
    open_example(page, installed, host, name, stream)
    page.wait("window.kept && (kept.currentTime > 0.1 || kept.frame > 3)")
    page.run("kept.pause(); kept.seek ? kept.seek(15) : (kept.currentTime = 0.5)")
    page.wait(ENGINES[name][1])
    reader = StreamReader(installed / f"{stream}-trained")
    camera = reader.manifest.camera().resized(320, 240)
    expected = render_splats(reader.active_splats(15, 1), camera, reader.manifest.near_m)

    def is_drawn() -> bool:
        page.screenshot(installed / f"{name}.png")
        picture = np.asarray(Image.open(installed / f"{name}.png").convert("RGB")) / 255
        return psnr_db(picture, expected.clip(0, 1)) >= least_psnr_db

    wait_until(is_drawn)
    assert page.value(ENGINES[name][1])
    page.run("kept.close ? kept.close() : kept.dispose()")
