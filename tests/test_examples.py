"""Every script of examples/ runs as its docstring describes; tests/player/web opens the pages."""

from __future__ import annotations

import importlib.util
import re
import runpy
import subprocess
import sys
import urllib.request
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import codec
from codec.splats import SH_C0
from codec.stream.playrecord import RecordParser, SliceRecord
from tests.support.commands import ROOT, environment, run_ok, serving
from tests.support.slots.slot_streams import write_slot_stream
from tests.support.slots.updates import small_layout
from tests.support.tiny_capture import write_dynerf
from tests.support.tiny_stream import tiny_manifest, write_tiny
from tests.support.waiting import BOUND_S

SCRIPTS = sorted((ROOT / "examples").glob("*.py"))
NUM_FRAMES = 40


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with demo/stream, used as demo/ by the scripts, and my-frames, a folder of PLYs."""
    root = tmp_path_factory.mktemp("examples")
    cameras = tuple(write_dynerf(root / "capture", num_frames=2))
    manifest = replace(tiny_manifest(), cameras=cameras, default_camera=cameras[1].name)
    write_tiny(root / "demo" / "stream", NUM_FRAMES, manifest)
    export = ("swings-stream", "export", root / "demo" / "stream", root / "my-frames" / "f.ply")
    run_ok(*export, "--frames", "0:3")
    return root


Runner = Callable[[str, Path], str]


@pytest.fixture
def run_example(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Runner:
    """Runs an example with the command line of its docstring in a folder; returns its output."""

    def run(name: str, folder: Path) -> str:
        script = ROOT / "examples" / name
        (line,) = re.findall(rf"^python examples/{name} (.+)$", script.read_text(), re.MULTILINE)
        monkeypatch.chdir(folder)
        monkeypatch.setattr(sys, "argv", [name, *line.split()])
        runpy.run_path(str(script), run_name="__main__")
        said, complained = capsys.readouterr()
        assert complained == ""
        return said

    return run


def test_frames(run_example: Runner, folder: Path) -> None:
    lines = run_example("frames.py", folder).splitlines()
    assert lines[0] == f"{NUM_FRAMES} frames at 25 per second, 2 layers"
    assert len(lines) == 1 + NUM_FRAMES
    count = len(codec.open_stream(folder / "demo" / "stream").frame(29))
    assert count > 50
    assert lines[30].startswith(f"frame 29: {count} Gaussians, ")


def test_turntable(run_example: Runner, folder: Path) -> None:
    run_example("turntable.py", folder)
    with av.open(str(folder / "turntable.mp4")) as video:
        pictures = [picture.to_ndarray(format="rgb24") for picture in video.decode(video=0)]
    assert len(pictures) == 24
    assert pictures[0].shape == (180, 320, 3)
    assert abs(pictures[0].astype(int) - pictures[12]).max() > 50


def test_importplys(run_example: Runner, folder: Path) -> None:
    printed = run_example("importplys.py", folder)
    assert printed.startswith("3 frames, ")
    stream = codec.open_stream(folder / "my-stream")
    assert (stream.num_frames, stream.num_layers, stream.fps) == (3, 3, 30)


def test_layerbytes(run_example: Runner, folder: Path, tmp_path: Path) -> None:
    """The numbers match the files."""
    layout = small_layout(1, (40, 30, 30), 0, 5)
    write_slot_stream(tmp_path / "demo" / "stream", 10, layout, seed=1)
    lines = run_example("layerbytes.py", tmp_path).splitlines()
    printed_kb = [float(found) for found in re.findall(r": ([\d.]+) kB", "\n".join(lines))]
    segments = tmp_path / "demo" / "stream" / "segments"
    on_disk_bytes = sum(file.stat().st_size for file in segments.rglob("*") if file.is_file())
    assert len(lines) == 3 + 2
    assert sum(printed_kb) == pytest.approx(on_disk_bytes / 10 / 1e3, abs=0.05)


def test_policy(folder: Path) -> None:
    (folder / "examples").symlink_to(ROOT / "examples")
    text = (ROOT / "examples" / "policy.py").read_text(encoding="utf-8")
    abr, serve = re.findall(r"^swings-\w+ (.+)$", text, re.MULTILINE)
    rows = [line.split() for line in run_ok("swings-abr", *abr.split(), folder=folder).splitlines()]
    (own,) = (row for row in rows if row[:2] == ["all", "Cautious"])
    (ours,) = (row for row in rows if row[:2] == ["all", "sweep"])
    assert float(own[-4]) < float(ours[-4])  # seconds until it starts
    assert all(1 <= float(row[-1]) <= 2 for row in (own, ours))  # layers
    _, option, policy = serve.split()
    with (
        serving(folder / "demo" / "stream", option, ROOT / policy) as url,
        urllib.request.urlopen(f"{url}/v1/streams/stream/play", timeout=BOUND_S) as response,
    ):
        records = RecordParser().feed(response.read())
    slices = [record for record in records if isinstance(record, SliceRecord)]
    assert len(slices) >= NUM_FRAMES - 1
    assert {len(record.packets) for record in slices} == {1}  # it never has 3 s to send ahead


@pytest.mark.skipif(importlib.util.find_spec("viser") is None, reason="viser is not installed")
def test_viserview(folder: Path) -> None:
    """A connection like a browser's receives the Gaussians of another frame."""
    import viser
    from websockets.sync.client import connect
    from websockets.typing import Subprotocol

    splats = codec.open_stream(folder / "demo" / "stream").frame(5)
    turns = Rotation.from_quat(splats.quats[:, [1, 2, 3, 0]]).as_matrix()
    variances = np.einsum("nij,nj,nkj->nik", turns, np.exp(2 * splats.log_scales), turns)
    variances = variances[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    command = [sys.executable, str(ROOT / "examples" / "viserview.py"), "demo/stream", "0"]
    process = subprocess.Popen(
        command, cwd=folder, env=environment(), stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    printed = next(line for line in process.stdout if line.startswith("showing "))
    address = printed.split()[-1].replace("http", "ws")
    protocols = [Subprotocol(f"viser-v{viser.__version__}")]
    size_bytes, rows = 32 * len(splats), np.zeros((0, 32), np.uint8)
    try:
        with connect(address, subprotocols=protocols, max_size=None, compression=None) as browser:
            while not np.array_equal(rows[:, :12].copy().view(np.float32), splats.means):
                message = browser.recv(decode=False)
                at = max(message.find(splats.means[0].tobytes()), 0)
                found = message[at : at + size_bytes].ljust(size_bytes)
                rows = np.frombuffer(found, np.uint8).reshape(-1, 32)
    finally:
        process.terminate()
        process.communicate()
    # Rows of 3 float32, a gap, the upper half of the covariance as float16, and RGBA.
    np.testing.assert_allclose(rows[:, 16:28].copy().view(np.float16), variances, 0.01, 1e-6)
    rgba = np.c_[np.clip(0.5 + SH_C0 * splats.sh[:, 0], 0, 1), splats.opacities]
    np.testing.assert_allclose(rows[:, 28:], 255 * rgba, atol=1)


def test_every_script_has_a_test_and_a_row() -> None:
    tested = Path(__file__).read_text(encoding="utf-8")
    table = (ROOT / "examples" / "README.md").read_text(encoding="utf-8")
    assert len(SCRIPTS) >= 6
    for script in SCRIPTS:
        assert f'"{script.name}"' in tested, script
        assert len(script.read_text(encoding="utf-8").splitlines()) <= 60, script
        assert f"]({script.name})" in table, script
