"""What README.md tells people to type works.

Each command is run as it stands there, in a folder with what it names. Behind some stand further
options, so that what takes minutes takes seconds, or needs no screen. `scripts/demo` and its
siblings are the exception: they install and run for minutes, so here they are only parsed.
"""

from __future__ import annotations

import ast
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
import tomllib
import urllib.request
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from codec.stream import StreamReader
from codec.stream.poster import POSTER_NAME
from tests.support.commands import ENTRY, ROOT, command, environment, serving
from tests.support.tiny_capture import write_dynerf
from tests.support.tiny_stream import tiny_manifest, write_tiny
from trainer.capture.layout import open_capture

README = (ROOT / "README.md").read_text(encoding="utf-8")
WORDS = [" ".join(words.split()) for words in re.findall(r"`([^`]+)`", README)]
COMMANDS = sorted({w for w in WORDS if re.match(r"(swings-\w+|python|pip|scripts/\w+)( |$)", w)})

TINY = "--num-gs 60 --genesis-iterations 4 --settle-rounds 1 --window-iterations 1"
BESIDES = {
    "swings-synth my-capture": "--frames 2 --cameras 5 --width-px 32 --height-px 32 --points 50",
    "swings-train my-capture my-stream --frames 0:60 --scale 0.5": TINY,
    "swings-play my-stream": "--capture played.mp4 --renderer cpu",
}
"""Options that are added, to need neither minutes nor a screen."""

MADE = {
    "swings-train my-capture --check rig.png": "rig.png",
    "swings-synth my-capture": "my-capture/poses_bounds.npy",
    "swings-train my-capture my-stream --frames 0:60 --scale 0.5": "my-stream/index.bin",
    "swings-train my-capture my-stream --resume": "my-stream/index.bin",
    "swings-stream info my-stream --plot rate.png": "rate.png",
    "swings-stream verify my-stream": "my-stream/manifest.json",
    "swings-eval my-stream my-capture --sheet sheet.png": "sheet.png",
    "swings-stream import model.ply my-stream": "my-stream/index.bin",
    "swings-stream export my-stream web --static": "web/manifest.json",
    "swings-play my-stream": "played.mp4",
    "swings-abr my-stream --traces DIR --out report": "report/index.html",
}
"""What each of these leaves."""

ELSEWHERE = {
    "swings-serve s3://BUCKET/STREAMS": "server/library/test_storelibrary.py",
    "swings-stream verify s3://BUCKET/STREAMS/NAME": "codec/storage/test_objectstore.py",
    "python -m fuzz FOUND fuzz/corpus": "codec/test_fuzz.py",
    "python -m fuzz http FOUND": "server/http/test_fuzz.py",
}
"""Commands whose words stand for something, and the tests that run what they start."""

SERVED = {"swings-serve my-stream", "swings-play http://127.0.0.1:8080"}


@pytest.fixture(scope="module")
def stock(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With my-capture, my-stream, model.ply and DIR, a folder of traces."""
    root = tmp_path_factory.mktemp("readme")
    write_dynerf(root / "my-capture", 5, 60)
    cameras = tuple(c.camera for c in open_capture(root / "my-capture").cameras)
    manifest = replace(
        tiny_manifest(), cameras=cameras, default_camera=cameras[0].name, poster=POSTER_NAME
    )
    write_tiny(root / "my-stream", 8, manifest)
    run_words(root, "swings-stream export my-stream model.ply --frame 0")
    (root / "DIR").mkdir()
    (root / "DIR" / "link.json").write_text(
        '[{"duration_ms": 60000, "bandwidth_kbps": 4000, "latency_ms": 20}]'
    )
    return root


@pytest.fixture
def folder(stock: Path, tmp_path: Path) -> Path:
    shutil.copytree(stock, tmp_path, dirs_exist_ok=True)
    return tmp_path


def run_words(folder: Path, words: str) -> str:
    name, *arguments = shlex.split(words)
    done = subprocess.run(
        command(name, *arguments),
        cwd=folder,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=200,
    )
    assert done.returncode == 0, f"{words}: {done.stderr}"
    return done.stdout


def test_every_command_of_the_page_has_a_test() -> None:
    held = {*MADE, *ELSEWHERE, *SERVED}
    bare = {w for w in COMMANDS if w.startswith(("scripts/", "pip ")) or w in ENTRY}
    bare |= {w for w in COMMANDS if w == "swings-stream export"}
    assert set(COMMANDS) - bare == held
    assert len(COMMANDS) > 20


@pytest.mark.parametrize("words", MADE)
def test_a_command_leaves_what_it_says(words: str, folder: Path) -> None:
    made = folder / MADE[words]
    if words.startswith(("swings-synth", "swings-stream import")) or "0:60" in words:
        shutil.rmtree(folder / made.relative_to(folder).parts[0])  # it is made anew
    if "--resume" in words:
        stop_a_run(folder)
    run_words(folder, f"{words} {BESIDES.get(words, '')}")
    assert made.stat().st_size > 0
    if "0:60" in words or "--resume" in words:
        assert StreamReader(folder / "my-stream").num_frames == 60


def stop_a_run(folder: Path) -> None:
    """Leaves my-stream as a run that was killed after its first window."""
    shutil.rmtree(folder / "my-stream")
    process = subprocess.Popen(
        command("swings-train", "my-capture", "my-stream", *TINY.split(), "--segment-frames", 9),
        cwd=folder,
        env=environment(),
        stderr=subprocess.DEVNULL,
    )
    while not (folder / "my-stream" / ".checkpoint.npz").exists():
        assert process.poll() is None
        time.sleep(0.01)
    process.kill()
    process.wait(timeout=20)
    assert StreamReader(folder / "my-stream").manifest.live


@pytest.mark.parametrize("words", ELSEWHERE)
def test_what_others_run_is_there(words: str) -> None:
    tree = ast.parse((ROOT / "tests" / ELSEWHERE[words]).read_text(encoding="utf-8"))
    names = [node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    assert any(name.startswith("test_") for name in names)


def test_what_is_served_can_be_played(folder: Path) -> None:
    with serving(folder / "my-stream") as url:
        words = "swings-play http://127.0.0.1:8080"
        run_words(
            folder,
            words.replace("http://127.0.0.1:8080", url) + " --capture served.mp4 --renderer cpu",
        )
    assert (folder / "served.mp4").stat().st_size > 0


def test_a_plain_web_server_serves_the_export(folder: Path) -> None:
    (block,) = re.findall(r"((?: {7}(?:swings-stream|cp|python3) .*\n)+)", README)
    export, copy, serve = (line.split("#")[0].strip() for line in block.splitlines())
    (folder / "player").mkdir()
    (folder / "player" / "web").symlink_to(ROOT / "player" / "web")
    run_words(folder, export)
    subprocess.run(shlex.split(copy.replace("-r", "-rL")), cwd=folder, check=True)
    _, *arguments = shlex.split(serve)
    process = subprocess.Popen(
        [sys.executable, "-u", *arguments, "0"],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        assert process.stdout is not None
        told = re.search(r"port (\d+)", process.stdout.readline())
        assert told
        for path in ("player/watch.html", "player/watch.js", "stream/manifest.json"):
            with urllib.request.urlopen(f"http://127.0.0.1:{told[1]}/{path}", timeout=20) as found:
                assert found.read(10)
    finally:
        process.terminate()
        process.wait(timeout=20)
        if process.stdout is not None:
            process.stdout.close()


@cache
def all_options() -> frozenset[str]:
    """Those that any help tells."""
    told = ""
    subcommands = [["swings-stream", name] for name in ("info", "verify", "import", "export")]
    for name, *words in [*([name] for name in ENTRY), *subcommands]:
        done = subprocess.run(
            command(name, *words, "--help"), env=environment(), capture_output=True, text=True
        )
        told += done.stdout
    return frozenset(re.findall(r"--[a-z][a-z0-9.-]*", told))


def test_every_option_that_is_named_is_one() -> None:
    named = {
        option
        for words in WORDS
        if not words.startswith(("python", "pip", "cp"))
        for option in re.findall(r"(?<![\w-])--[a-z][a-z0-9.-]*", words)
    }
    assert len(named) > 30
    assert not named - all_options()


def test_extras_and_scripts_that_are_named_are_there() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for extra in re.findall(r"pip install '\.\[(\w+)\]'", README):
        assert extra in project["optional-dependencies"]
    for script in re.findall(r"\bscripts/\w+", README):
        assert os.access(ROOT / script, os.X_OK)
        subprocess.run(["sh", "-n", ROOT / script], check=True)
    assert set(project["scripts"]) == set(ENTRY)
