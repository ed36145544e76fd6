"""The commands of README.md and docs/GUIDE.md work.

Each command is run as written, in a folder with the files that it names. Some get further options,
so that they take seconds instead of minutes, or need no screen. Only the syntax of `scripts/` is
checked here; test_demo.py runs the demo.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tomllib
import urllib.request
from dataclasses import replace
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from codec.stream import StreamReader
from codec.stream.poster import POSTER_NAME
from tests.support.commands import ENTRY, ROOT, command, environment, run_ok, serving
from tests.support.tiny_capture import seen_by, write_dynerf
from tests.support.tiny_stream import tiny_manifest, write_tiny
from tests.support.waiting import BOUND_S, wait_until

README = (ROOT / "README.md").read_text(encoding="utf-8")
RESULTS = (ROOT / "docs" / "RESULTS.md").read_text(encoding="utf-8")
PAGES = README + (ROOT / "docs" / "GUIDE.md").read_text(encoding="utf-8")
MOST_WORDS = 700
FIGURE = r"\d+(?:,\d{3})*(?:\.\d+)?"
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z0-9.-]*")
NUM_FRAMES = 32
IS_COMMAND = re.compile(r"(swings-\w+|python3?|pip|cp|git|scripts/\w+)( |$)")


def written_words() -> list[str]:
    """All text in backticks, and every line of an indented block without its comment."""
    lines = re.findall(r"^ {4,}(\S.*)$", PAGES, re.MULTILINE)
    spans = re.findall(r"`([^`]+)`", PAGES)
    return [" ".join(re.sub(r"  +#.*", "", words).split()) for words in [*lines, *spans]]


WORDS = written_words()
COMMANDS = sorted({words for words in WORDS if IS_COMMAND.match(words)})

TINY = "--num-gs 60 --genesis-iterations 4 --settle-rounds 1 --window-iterations 1"
TRAIN, OF_VIDEOS = "swings-train my-capture my-stream", "swings-train my-videos my-stream"
PLAYED = "--renderer cpu --size 64x36"
BESIDES = {
    "swings-synth my-capture": "--frames 2 --cameras 5 --width-px 32 --height-px 32 --points 50",
    TRAIN: TINY,
    OF_VIDEOS: TINY,
    "swings-play my-stream": f"--capture played.mp4 {PLAYED}",
    "swings-abr my-stream --traces DIR --out report": "--length 5 --loads 1 --jobs 1",
}
"""Added options, so that a command needs neither minutes nor a screen; PLAYED for other plays."""

MADE = {
    "swings-train my-capture --check rig.png": "rig.png",
    "swings-synth my-capture": "my-capture/poses_bounds.npy",
    TRAIN: "my-stream/index.bin",
    OF_VIDEOS: "my-stream/index.bin",
    "swings-train my-capture my-stream --resume": "my-stream/index.bin",
    "swings-stream info my-stream --plot rate.png": "rate.png",
    "swings-stream verify my-stream": "my-stream/manifest.json",
    "swings-eval my-stream my-capture --sheet sheet.png": "sheet.png",
    "swings-eval my-stream my-stream-capture --sheet sheet.png": "sheet.png",
    "swings-stream import model.ply my-still": "my-still/index.bin",
    "swings-stream import my-frames my-video --fps 30": "my-video/index.bin",
    "swings-stream export my-stream frame.sog --frame 1": "frame.sog",
    "swings-stream pack my-stream my-stream.swings": "my-stream.swings",
    "swings-stream edit crop my-stream my-crop --box -1 0 -1 1 2 1": "my-crop/index.bin",
    "swings-stream edit crop my-stream my-ball --sphere 0 1 0 1.5": "my-ball/index.bin",
    "swings-stream edit transform my-stream my-turned --turn 90 0 0 --scale 3": (
        "my-turned/index.bin"
    ),
    "swings-stream edit floaters my-stream my-clean": "my-clean/index.bin",
    "swings-stream edit view my-stream my-better --view=-0.6,0.2,0.8,0,0 --title Fox": "my-better",
    "swings-stream edit view my-stream my-front --camera cam03": "my-front/index.bin",
    "swings-stream edit trim my-stream my-part --frames 10:30": "my-part/index.bin",
    "swings-stream edit join my-intro my-film --then my-stream": "my-film/index.bin",
    "swings-play my-stream": "played.mp4",
    "swings-play my-stream --capture out.mp4": "out.mp4",
    "swings-play my-stream --camera orbit --capture orbit.mp4": "orbit.mp4",
    "swings-play my-stream --fps 60 --capture smooth.mp4": "smooth.mp4",
    "swings-play my-stream --still 30 --capture frame.png": "frame.png",
    "swings-play my-stream --still 30 --turntable 4 --capture turn.mp4": "turn.mp4",
    "swings-play my-stream --still 30 --capture white.png --background ffffff": "white.png",
    "swings-play my-stream --still 30 --capture cut.png --background transparent": "cut.png",
    "swings-play my-stream --capture cut --background transparent": "cut/frame_00031.png",
    "swings-play my-stream --still 30 --capture depth.png --picture depth": "depth.png",
    "swings-play my-stream --capture depth --picture depth": "depth/frame_00031.png",
    "swings-play my-stream --capture masks --picture mask": "masks/frame_00031.png",
    "swings-play my-stream --camera flight.json --capture flight.mp4": "flight.mp4",
    "swings-abr my-stream --traces DIR --out report": "report/plays.csv",
}
"""The file that each of these commands writes."""

ELSEWHERE = {
    "codec/tracks/test_streamsound.py": [
        "swings-stream audio add my-stream music.wav",
        "swings-stream audio add my-stream voice.flac --name voice --at-m 0 1 2",
        "swings-stream audio add my-stream steps.wav --name steps --path path.json --offset-s 0.5",
        "swings-stream audio extract my-stream heard.wav",
        "swings-stream audio remove my-stream",
        "swings-stream captions add my-stream english.vtt --language en --label English",
        "swings-stream captions remove my-stream --language en",
    ],
    "server/library/test_storelibrary.py": ["swings-serve s3://BUCKET/STREAMS"],
    "codec/storage/test_objectstore.py": ["swings-stream verify s3://BUCKET/STREAMS/NAME"],
    "codec/tools/test_packing.py": ["swings-stream unpack my-stream.swings my-folder"],
    "server/library/test_packedlibrary.py": ["swings-serve FOLDER"],
    "player/source/test_packed_host.py": [
        "swings-play https://streams.example.com/my-stream.swings"
    ],
    "codec/test_fuzz.py": ["python -m fuzz"],
    "trainer/calibrate/test_calibrate.py": [
        "swings-capture calibrate my-videos my-capture",
    ],
    "test_demo.py": ["scripts/demo", "scripts/demo --no-serve"],
    "bench/test_cuda.py": ["scripts/bench cuda"],
}
"""Tests that run the programs of commands with placeholders, or that take long."""

SERVED = {"swings-serve my-stream", "swings-serve --sample", "swings-play http://127.0.0.1:8080"}
SITE = {"swings-stream export my-stream site --static --page", "python3 -m http.server -d site"}
"""Commands of a web server without swings."""
NOT_RUN = {"git clone <this repository> swings"}


@pytest.fixture(scope="module")
def stock(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with my-capture, my-stream, my-intro, model.ply, my-frames, the guide's flight.json,
    and DIR, a folder of traces."""
    root = tmp_path_factory.mktemp("readme")
    write_dynerf(root / "my-capture", 5, 60)
    # As if calibrated, which takes minutes.
    shutil.copytree(root / "my-capture", root / "my-stream-capture")
    shutil.copytree(root / "my-capture", root / "my-videos", ignore=shutil.ignore_patterns("*.npy"))
    manifest = replace(seen_by(tiny_manifest(), root / "my-capture"), poster=POSTER_NAME)
    write_tiny(root / "my-stream", NUM_FRAMES, manifest)
    run_words(root, "swings-stream export my-stream model.ply --frame 0")
    run_words(root, "swings-stream export my-stream my-frames/frame.ply --frames 0:3")
    run_words(root, "swings-stream edit trim my-stream my-intro --frames :5")
    (flight,) = (words for words in WORDS if words.startswith('[{"frame"'))
    (root / "flight.json").write_text(flight)
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
    return run_ok(name, *arguments, folder=folder)


def test_every_command_of_the_pages_has_a_test() -> None:
    bare = {w for w in COMMANDS if w.startswith("pip ") or w in ENTRY}
    bare |= {w for w in COMMANDS if re.fullmatch(r"scripts/(setup|test|check|bench( NAME)?)", w)}
    assert set(COMMANDS) - bare == {*MADE, *chain(*ELSEWHERE.values()), *SERVED, *SITE, *NOT_RUN}
    assert len(COMMANDS) > 30
    assert all((ROOT / "tests" / file).is_file() for file in ELSEWHERE)


def test_the_readme_is_short_and_begins_with_a_moving_picture() -> None:
    assert len(README.split()) <= MOST_WORDS
    picture = ROOT / "docs" / "watch.webp"
    assert f"](docs/{picture.name})" in README
    assert picture.stat().st_size < 1_000_000
    with Image.open(picture) as image:
        assert getattr(image, "n_frames", 1) > 30


def test_every_figure_that_the_readme_claims_was_measured() -> None:
    """They are among the results of docs/RESULTS.md."""
    claimed = re.findall(FIGURE, README.partition("## Measured")[2].partition("\n## ")[0])
    assert len(claimed) > 20
    assert not set(claimed) - set(re.findall(rf"(?<![\d.]){FIGURE}(?!\d)", RESULTS))


def test_the_results_can_be_measured_again() -> None:
    """Every bench exists, and every option of our commands."""
    lines = re.findall(r"^ {4}(\S.*)$", RESULTS, re.MULTILINE)
    benches = {words[1] for words in map(str.split, lines) if words[0] == "scripts/bench"}
    assert len(benches) > 10
    assert benches <= {path.stem for path in (ROOT / "bench").rglob("*.py")}
    named = {o for line in lines if line.startswith("swings-") for o in OPTION.findall(line)}
    assert not named - all_options()


@pytest.mark.parametrize("words", MADE)
def test_a_command_leaves_what_it_says(words: str, folder: Path) -> None:
    made = folder / MADE[words]
    if words.startswith("swings-synth") or words in (TRAIN, OF_VIDEOS):
        shutil.rmtree(folder / made.relative_to(folder).parts[0])  # the command makes it again
    if "--resume" in words:
        stop_a_run(folder)
    plays = words.startswith("swings-play")
    run_words(folder, f"{words} {BESIDES.get(words, PLAYED if plays else '')}")
    assert made.stat().st_size > 0
    if words in (TRAIN, OF_VIDEOS) or "--resume" in words:
        assert StreamReader(folder / "my-stream").num_frames == 60


def stop_a_run(folder: Path) -> None:
    """Makes my-stream the output of a run that was killed after its first window."""
    shutil.rmtree(folder / "my-stream")
    process = subprocess.Popen(
        command("swings-train", "my-capture", "my-stream", *TINY.split(), "--segment-frames", 9),
        cwd=folder,
        env=environment(),
        stderr=subprocess.DEVNULL,
    )
    checkpoint = folder / "my-stream" / ".checkpoint.npz"
    wait_until(lambda: checkpoint.exists() or process.poll() is not None)
    process.kill()
    assert process.wait(timeout=BOUND_S) == -signal.SIGKILL
    assert StreamReader(folder / "my-stream").manifest.live


@pytest.mark.parametrize("root", ["my-stream", "--sample"])
def test_what_is_served_can_be_played(folder: Path, root: str) -> None:
    with serving(root if root.startswith("-") else folder / root) as url:
        run_words(folder, f"swings-play {url} --capture served.mp4 {PLAYED}")
    assert (folder / "served.mp4").stat().st_size > 0


def test_a_plain_web_server_serves_the_export(folder: Path) -> None:
    export, serve = (words for words in WORDS if words in SITE)
    run_words(folder, export)
    _, *arguments = shlex.split(serve)
    command_line = [sys.executable, "-u", *arguments, "0"]
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(command_line, cwd=folder, text=True, **pipes) as process:
        try:
            assert process.stdout is not None
            told = re.search(r"port (\d+)", process.stdout.readline())
            assert told
            for path in ("", "player/player.js", "player/playworker.js", "manifest.json"):
                with urllib.request.urlopen(f"http://127.0.0.1:{told[1]}/{path}") as found:
                    assert found.read(10)
        finally:
            process.terminate()


@cache
def all_options() -> frozenset[str]:
    """All options in the help texts."""
    told = ""
    subcommands = [["swings-stream", name] for name in ("info", "verify", "import", "export")]
    kinds = ("crop", "transform", "floaters", "view", "trim", "join")
    subcommands += [["swings-stream", "edit", kind] for kind in kinds]
    subcommands += [["swings-stream", "audio", kind] for kind in ("add", "remove", "extract")]
    subcommands += [["swings-stream", "captions", kind] for kind in ("add", "remove")]
    for name, *words in [*([name] for name in ENTRY), *subcommands]:
        told += run_ok(name, *words, "--help-all")
    return frozenset(re.findall(r"--[a-z][a-z0-9.-]*", told))


def test_every_option_that_is_named_is_one() -> None:
    named = {
        option
        for words in WORDS
        if not words.startswith(("python", "pip", "cp", "scripts"))
        for option in OPTION.findall(words)
    }
    assert len(named) > 30
    assert not named - all_options() - {"--help-all"}  # itself


def test_extras_and_scripts_that_are_named_are_there() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for extra in re.findall(r"pip install '\.\[(\w+)\]'", PAGES):
        assert extra in project["optional-dependencies"]
    for script in re.findall(r"\bscripts/\w+", PAGES):
        assert os.access(ROOT / script, os.X_OK)
        subprocess.run(["sh", "-n", ROOT / script], check=True)
    assert set(project["scripts"]) == set(ENTRY)
