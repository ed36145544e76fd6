"""The sources of the browser player: their types and those of the npm package, their style, and the
tests beside them."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from scripts.npmpackage import write_description, write_types
from scripts.webmodules import modules
from tests.support.suite.once import made_once
from tests.support.waiting import BOUND_S
from tests.support.web.nodeprocess import NODE, SCRIPTS

PACKAGES = SCRIPTS / "node_modules"
FOLDER = Path(__file__).parents[3] / "player" / "web" / "test"


def run(tool: str, *arguments: str, folder: Path = SCRIPTS) -> None:
    """Runs a tool of the npm packages, which must find nothing wrong."""
    command = [str(PACKAGES / ".bin" / tool), *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def make_project(project: Path) -> None:
    """A project that has the declarations of the npm package, and engines. Raises ToolError where a
    source of the player breaks a rule of types (`tsc --checkJs`, strict)."""
    package = project / "node_modules" / "swings-player"
    package.mkdir(parents=True)
    write_types(package)
    write_description(package)
    for name in ("@sparkjsdev", "playcanvas", "three"):
        (project / "node_modules" / name).symlink_to(PACKAGES / name)
    for name, text in CONSUMERS.items():
        (project / name).write_text(text, encoding="utf-8")


@pytest.fixture
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if NODE is None or not PACKAGES.is_dir():
        pytest.skip("needs Node.js with npm: apt-get install npm, then scripts/setup dev")
    return made_once(tmp_path_factory, "webtypes", make_project)


def test_the_types_of_the_sources_hold_and_each_entry_has_its_own(project: Path) -> None:
    package = project / "node_modules" / "swings-player"
    description = json.loads((package / "package.json").read_text(encoding="utf-8"))
    for targets in description["exports"].values():
        assert isinstance(targets, str) or (package / targets["types"]).is_file()


CONSUMERS = {
    "consumer.ts": """
import "swings-player";
import { SwingsPlayerElement } from "swings-player";
import { GaussianFeed } from "swings-player/feed";
import { Fetcher, openSource, Playback, StreamPlay } from "swings-player/core";

const player: SwingsPlayerElement = document.createElement("swings-player");
player.preload = "metadata";
const playing: Promise<void> = player.play();
const end: number = player.buffered.end(0);
player.requestVideoFrameCallback((nowMs: number, { mediaTime }) => nowMs + mediaTime);
const media: MediaStream = player.captureStream(30);
const feed = new GaussianFeed("stream", { otherHosts: true });
const means: Float32Array = feed.gaussians.means;
const numGs: Promise<number> = feed.opened.then((stream) => stream.numGs);
const fps: Promise<number> = openSource("stream/", new Fetcher()).then(({ manifest }) => {
  new Playback(new StreamPlay(manifest), manifest.fps, 1, 0);
  return manifest.fps;
});
// @ts-expect-error: no such mode
player.preload = "everything";
// @ts-expect-error: a number of seconds
player.currentTime = "1";
export { playing, end, media, means, numGs, fps };
""",
    "inplaycanvas.ts": """
import { Application, Entity } from "playcanvas";
import { RECIPE, SwingsEntity } from "swings-player/playcanvas";

const app = new Application(document.createElement("canvas"));
Object.assign(app.scene.gsplat, RECIPE);
const entity = new SwingsEntity(app, { url: "stream", loop: false });
entity.currentTime = 1;
export const camera: Promise<Entity> = entity.defaultCamera();
// @ts-expect-error: it has no stream
export const empty = new SwingsEntity(app, { loop: false });
""",
}
STRICT = ["--strict", "--noEmit", "--target", "es2024", "--module", "es2022"]
LIBRARIES = ["--moduleResolution", "bundler", "--lib", "es2024,dom,dom.iterable"]


@pytest.mark.parametrize(
    ("name", "flag"),
    [
        ("consumer.ts", "--skipDefaultLibCheck"),
        # The types of PlayCanvas need other types, which npm would install with it.
        ("inplaycanvas.ts", "--skipLibCheck"),
    ],
)
def test_types_hold_in_a_strict_project(project: Path, name: str, flag: str) -> None:
    run("tsc", *STRICT, *LIBRARIES, flag, name, folder=project)


def test_the_style() -> None:
    if NODE is None or not PACKAGES.is_dir():
        pytest.skip("needs Node.js with npm: apt-get install npm, then scripts/setup dev")
    package = json.loads((SCRIPTS / "package.json").read_text(encoding="utf-8"))
    run(*package["scripts"]["style"].split())


@pytest.mark.parametrize("path", modules(), ids=lambda path: path.name)
def test_what_is_generated_is_not_stale(path: Path) -> None:
    assert path.read_text(encoding="utf-8") == modules()[path], "stale: run scripts/webmodules"


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.test.mjs")), ids=lambda path: path.name)
def test_the_modules_that_need_no_page(path: Path) -> None:
    """Their tests are beside them: `node --test player/web/test/*.test.mjs`."""
    if NODE is None:
        pytest.skip("needs Node.js: apt-get install nodejs")
    command = [NODE, "--test", "--test-reporter=spec", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=5 * BOUND_S)
    assert done.returncode == 0, done.stdout + done.stderr
