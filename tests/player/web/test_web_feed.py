"""A stream as Gaussians for renderers of others, and one of them that draws it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from codec.profiles.profile import Profile
from codec.splats import SH_C0, Splats
from codec.stream.reader import StreamReader
from codec.tools.static import export_static
from player.render.cpu import render_splats
from player.render.recipe import ALPHA_MIN
from tests.goldens.pinned_slots import folder_files
from tests.support.hosted_streams import static_host, write_stream
from tests.support.slots.slot_streams import write_slot_stream
from tests.support.slots.updates import small_layout
from tests.support.web.browsercode import BrowserCode
from tests.support.web.chromium import Page
from tests.support.web.nodeprocess import SCRIPTS

ROOT = Path(__file__).parents[3]
EXAMPLE = ROOT / "examples" / "spark.html"
EXAMPLE_HOST = "https://streams.example.com"
LEAST_PSNR_DB = 25.0
NUM_FRAMES = 17
LOOKS = [3, 4, 5, 9, 16]


def rows_of(splats: Splats) -> np.ndarray:
    """(N, 14 + 3 (K - 1)): mean, scales, quaternion, opacity, colour, harmonics; sorted."""
    opacities = 1 / (1 + np.exp(-splats.logit_opacities.astype(np.float64)))
    parts = (
        splats.means,
        np.exp(splats.log_scales),
        splats.quats / np.linalg.norm(splats.quats, axis=1, keepdims=True),
        opacities[:, None],
        0.5 + SH_C0 * splats.sh[:, 0],
        splats.sh[:, 1:].reshape(len(splats.means), -1),
    )
    return sorted_rows(np.hstack(parts)[opacities >= ALPHA_MIN].astype(np.float32))


def sorted_rows(rows: np.ndarray) -> np.ndarray:
    """In an order that only exact numbers decide: those of the mean and the harmonics."""
    keys = np.hstack([rows[:, 14:], rows[:, :3]])
    return rows[np.lexsort(keys.T)]


@pytest.mark.parametrize("kind", ["raw", "compact", "lanes-1", "lanes-3"])
@pytest.mark.parametrize("first", [0, 3])
def test_the_gaussians_are_those_of_the_package(
    browser: BrowserCode, tmp_path: Path, kind: str, first: int
) -> None:
    """However seldom one looks, and when the stream begins anew."""
    path = tmp_path / "stream"
    match kind:
        case "raw":
            write_stream(path, NUM_FRAMES, slice_size=8)
        case "compact":
            write_stream(path, NUM_FRAMES, 8, 0, profile=Profile.COMPACT)
        case _:
            swin_size = int(kind.removeprefix("lanes-"))
            write_slot_stream(path, NUM_FRAMES, small_layout(swin_size, (9, 6, 5), 1, 5), seed=3)
    export_static(path, tmp_path / "static")
    found = browser.ask("fed", files=folder_files(tmp_path / "static"), first=first, looks=LOOKS)
    reader = StreamReader(path)
    for frame, seen in zip([*LOOKS, LOOKS[-1]], found, strict=True):
        expected = rows_of(reader.active_splats(frame, reader.manifest.num_layers))
        bits = bytes.fromhex("".join(seen["gaussians"]))
        rows = sorted_rows(np.frombuffer(bits, np.float32).reshape(-1, expected.shape[1]))
        np.testing.assert_array_equal(rows[:, :3], expected[:, :3])
        np.testing.assert_allclose(rows, expected, rtol=1e-5, atol=1e-6)
    # From one frame to the next only what changed is new.
    assert found[LOOKS.index(4)]["numNew"] < reader.manifest.num_gs


SETTLED = """(() => {
  const now = [feed.frame, spark.current.version].join();
  window.looks = now === window.before ? (window.looks ?? 0) + 1 : 0;
  window.before = now;
  return window.looks > 8 && !spark.sorting && !spark.sortDirty;
})()"""
SHOWN = """
const { opacities, means } = feed.gaussians;
const slots = [...opacities.keys()].filter((slot) => opacities[slot] > 0);
const centres = slots.map((slot) => splats.getSplat(slot).center.toArray());
return { frame: feed.frame, centres };
"""


@pytest.mark.parametrize("sh_degree", [0, 1])
def test_spark_draws_a_stream(page: Page, tmp_path: Path, sh_degree: int) -> None:
    """examples/spark.html: the same centres, and much the same picture."""
    packages = SCRIPTS / "node_modules"
    if not (packages / "@sparkjsdev").is_dir():
        pytest.skip("needs the npm packages of the tests: scripts/setup dev")
    # Of one layer: which others are there in time is the link's doing.
    write_stream(tmp_path / "trained", 30, 150, sh_degree, layers=(1.0,))
    export_static(tmp_path / "trained", tmp_path / "stream")
    (tmp_path / "web").symlink_to(ROOT / "player" / "web")
    (tmp_path / "npm").symlink_to(packages)
    with static_host(tmp_path) as url:
        text = EXAMPLE.read_text(encoding="utf-8")
        (tmp_path / "spark.html").write_text(text.replace(EXAMPLE_HOST, url), encoding="utf-8")
        page.open(f"{url}/spark.html", 320, 240)
        page.wait("window.feed?.frame > 3", 60)
        page.run("feed.pause()")
        page.wait(SETTLED, 60)
        page.screenshot(tmp_path / "spark.png")
        shown = page.run(SHOWN)
        assert not page.complaints
    reader = StreamReader(tmp_path / "trained")
    manifest = reader.manifest
    splats = reader.active_splats(shown["frame"], manifest.num_layers)
    expected = rows_of(splats)[:, :3]
    centres = np.array(shown["centres"], np.float32)
    np.testing.assert_array_equal(sorted_rows(centres), expected)
    picture = np.asarray(Image.open(tmp_path / "spark.png").convert("RGB")) / 255
    camera = manifest.camera().resized(320, 240)
    error = picture - render_splats(splats, camera, manifest.near_m).clip(0, 1)
    assert -10 * np.log10(np.mean(error**2)) >= LEAST_PSNR_DB
