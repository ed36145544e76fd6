"""Small streams with visible content, and servers as processes, for tests of the player."""

from __future__ import annotations

import contextlib
import io
import json
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from socketserver import BaseServer
from typing import Any
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np

from codec.camera import Camera, look_at
from codec.lattice.lattice import Lattice
from codec.slice import Slice
from codec.splats import Splats, sh_count
from codec.stream import StreamWriter
from codec.stream.manifest import Manifest
from codec.stream.wholeslice import split_counts
from tests.support.commands import IDLE, ROOT
from tests.support.ports import kept_port
from tests.support.waiting import BOUND_S, wait_until

SWIN_SIZE = 5  # the paper's
SEGMENT_FRAMES = 5
SLICE_SIZE = 40
WIDTH_PX, HEIGHT_PX = 64, 48
LATTICE = Lattice(1 / 512, 1 / 16, 1 / 100, 1 / 40, 64)


def ring_of_cameras(count: int = 4) -> tuple[Camera, ...]:
    """Cameras c0, c1, ... on a circle around (0, 0, 4), at its height, which look at it."""
    cameras = []
    for n in range(count):
        angle = 2 * np.pi * n / count
        place = np.array([4 * np.sin(angle), 0.0, 4 - 4 * np.cos(angle)])
        pose = look_at(place, np.array([0.0, 0.0, 4.0]), np.array([0.0, -1.0, 0.0]))
        size = (WIDTH_PX, HEIGHT_PX, 60.0, 60.0, WIDTH_PX / 2, HEIGHT_PX / 2)
        cameras.append(Camera(f"c{n}", *size, pose))
    return tuple(cameras)


def small_manifest(
    slice_size: int = SLICE_SIZE, sh_degree: int = 1, fps: float = 30.0, **changes: object
) -> Manifest:
    """changes: fields of the manifest; layers: the share of the slots in each layer."""
    shares = changes.pop("layers", (0.25, 0.25, 0.5))
    slots = split_counts(slice_size, shares)  # type: ignore[arg-type]
    values: dict[str, object] = {
        "fps": fps,
        "swin_size": SWIN_SIZE,
        "slots": slots,
        "lattice": (LATTICE,) * len(slots),
        "segment_frames": SEGMENT_FRAMES,
        "sh_degree": sh_degree,
        "antialias": False,
        "near_m": 0.5,
        "bounds": ((-2.0, -2.0, 2.0), (2.0, 2.0, 6.0)),
        "cameras": ring_of_cameras(),
        "default_camera": "c0",
        "live": False,
    }
    return Manifest(**(values | changes))  # type: ignore[arg-type]


def random_splats(count: int, sh_degree: int, seed: int) -> Splats:
    """Gaussians in front of the default camera, of many sizes, opacities and colours."""
    rng = np.random.default_rng(seed)
    arrays = (
        rng.uniform(-1, 1, (count, 3)) * (1.5, 1, 1.5) + (0, 0, 4),
        rng.normal(-2.5, 0.7, (count, 3)),
        rng.normal(size=(count, 4)),
        rng.normal(0.5, 2, count),
        rng.normal(0, 0.7, (count, sh_count(sh_degree), 3)),
    )
    return Splats(*(array.astype(np.float32) for array in arrays))


def random_slice(
    birth: int, count: int = SLICE_SIZE, sh_degree: int = 1, swin_size: int = SWIN_SIZE
) -> Slice:
    """A slice that depends only on the arguments; some of its Gaussians start late."""
    latest = min(2, swin_size - 1)
    offsets = np.random.default_rng(birth + 500).integers(0, latest + 1, count).astype(np.uint8)
    return Slice(birth, random_splats(count, sh_degree, birth + 1000), offsets)


def write_stream(
    path: Path,
    num_frames: int,
    slice_size: int = SLICE_SIZE,
    sh_degree: int = 1,
    fps: float = 30.0,
    seed: int = 0,
    **changes: object,
) -> Path:
    """A finished stream at `path`, whose slices are whole and hold `random_slice` exactly. seed:
    another one gives other Gaussians."""
    manifest = small_manifest(slice_size, sh_degree, fps, **changes)
    with StreamWriter.create(path, manifest, exact=True) as writer:
        for birth in range(1 - manifest.swin_size, num_frames):
            made = random_slice(birth + seed, slice_size, sh_degree, manifest.swin_size)
            writer.append(replace(made, birth=birth))
    return path


@contextlib.contextmanager
def answering(server: BaseServer) -> Iterator[None]:
    """Answers requests to `server` in a thread; closes it at the end."""
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    try:
        yield
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@contextlib.contextmanager
def static_host(
    folder: Path, port: int = 0, cors: bool = False, objects_bps: float | None = None
) -> Iterator[str]:
    """Runs a plain file server of `folder`; gives its URL. port: 0 selects one that stays free.
    cors: pages of other origins may read the files. objects_bps: rate of all segments' objects
    together."""
    link = threading.Lock()

    class Handler(SimpleHTTPRequestHandler):
        def send_head(self) -> Any:
            """For modules of player/web, a shader or a style is one, too (tools/textmodules.js)."""
            file = Path(self.translate_path(self.path))
            is_text = file.suffix in (".glsl", ".css") and file.is_file()
            if not is_text or self.headers["Sec-Fetch-Dest"] != "script":
                return super().send_head()
            data = f"export default {json.dumps(file.read_text())};".encode()
            self.send_response(200)
            self.send_header("Content-Type", "text/javascript")
            self.send_header("Content-Length", f"{len(data)}")
            self.end_headers()
            return io.BytesIO(data)

        def end_headers(self) -> None:
            if cors:
                self.send_header("Access-Control-Allow-Origin", "*")
            super().end_headers()

        def copyfile(self, source: Any, outputfile: Any) -> None:
            if objects_bps is None or "/segments/" not in self.path:
                super().copyfile(source, outputfile)
                return
            while piece := source.read(256):
                with link:
                    time.sleep(8 * len(piece) / objects_bps)  # sleeps: the pace of the link
                    outputfile.write(piece)

        def log_message(self, format: str, *args: object) -> None:
            pass

    server = ThreadingHTTPServer(
        ("127.0.0.1", port or kept_port()), partial(Handler, directory=str(folder))
    )
    with answering(server):
        yield f"http://127.0.0.1:{server.server_port}"


class ServerProcess:
    """swings-serve as a process that can be killed and restarted at the same port."""

    def __init__(self, root: Path, port: int = 0, words: Sequence[str] = ()) -> None:
        place = "--port", str(port or kept_port())
        command = [sys.executable, "-m", "server", str(root), *place, *IDLE, *words]
        self.process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        ready = self.process.stdout.readline()
        assert ready.startswith("serving http://"), ready
        self.url = ready.split()[1]
        self.port = int(self.url.rpartition(":")[2])

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()
        assert self.process.stdout is not None
        self.process.stdout.close()


@contextlib.contextmanager
def served(root: Path, *words: str) -> Iterator[ServerProcess]:
    server = ServerProcess(root, words=words)
    try:
        yield server
    finally:
        server.kill()


def wait_for_stream(server: ServerProcess, name: str) -> None:
    """Waits until `server` serves the stream `name`."""

    def is_there() -> bool:
        try:
            with urlopen(f"{server.url}/v1/streams/{name}/manifest.json", timeout=BOUND_S):
                return True
        except HTTPError:
            return False

    wait_until(is_there)


def folder_files(stream: Path) -> dict[str, str]:
    """The contents of a folder's files in hexadecimal, by name."""
    paths = sorted(path for path in stream.rglob("*") if path.is_file())
    return {path.relative_to(stream).as_posix(): path.read_bytes().hex() for path in paths}
