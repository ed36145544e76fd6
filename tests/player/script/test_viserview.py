"""A stream in viser, with a real server: it serves the page and sends the Gaussians of a frame."""

from __future__ import annotations

import importlib.util
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given

from codec.errors import InvalidError
from codec.splats import SH_C0, Splats
from player import Scene
from player.script.viserview import ViserView, viser_arrays
from tests.support.commands import started
from tests.support.drawn import drawn_splats
from tests.support.reference_render import rotations
from tests.support.waiting import BOUND_S

HAS_VISER = importlib.util.find_spec("viser") is not None
needs_viser = pytest.mark.skipif(not HAS_VISER, reason="viser is not installed (extra viser)")


@given(drawn_splats(position=10.0, log_scale=(-5.0, 1.0)))
def test_covariances_colours_and_opacities_are_those_of_the_gaussians(splats: Splats) -> None:
    centres, covariances, colours, opacities = viser_arrays(splats)
    np.testing.assert_array_equal(centres, splats.means)
    assert covariances.shape == (len(splats), 3, 3)
    turns = rotations(torch.tensor(splats.quats).double()).numpy()
    variances = np.exp(2 * splats.log_scales.astype(np.float64))
    for n, turn in enumerate(turns):
        expected = turn @ np.diag(variances[n]) @ turn.T
        np.testing.assert_allclose(covariances[n], expected, atol=1e-5 * variances[n].max())
    light = 0.5 + SH_C0 * splats.sh[:, 0].astype(np.float64)
    np.testing.assert_allclose(colours, np.clip(light, 0, 1), atol=1e-6)
    np.testing.assert_allclose(opacities[:, 0], splats.opacities, atol=1e-6)


def sent(splats: Splats) -> bytes:
    """The Gaussians in the form for a browser: rows of 3 float32, a gap, 6 float16, RGBA."""
    centres, covariances, colours, opacities = viser_arrays(splats)
    rows = np.zeros((len(splats), 32), np.uint8)
    rows[:, :12] = np.ascontiguousarray(centres).view(np.uint8)
    upper = covariances[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]].astype(np.float16)
    rows[:, 16:28] = np.ascontiguousarray(upper).view(np.uint8)
    rows[:, 28:] = (np.concatenate([colours, opacities], axis=1) * 255).astype(np.uint8)
    return rows.tobytes()


@contextmanager
def browser(url: str) -> Iterator[Any]:
    """A connection like a browser's."""
    import viser
    from websockets.sync.client import connect
    from websockets.typing import Subprotocol

    protocols = [Subprotocol(f"viser-v{viser.__version__}")]
    address = url.replace("http", "ws")
    with connect(address, subprotocols=protocols, max_size=None, compression=None) as connection:
        yield connection


def receive(connection: Any, wanted: bytes) -> None:
    """Returns when `wanted` has arrived."""
    while wanted not in connection.recv(timeout=BOUND_S):
        pass


@needs_viser
def test_the_command_shows_a_stream_until_it_is_ended(stream: Path) -> None:
    words = ("--viser", 0, "--frames", "3:9", "--camera", "camera:c2")
    process = started("swings-play", stream, *words, stdout=subprocess.PIPE)
    assert process.stdout is not None
    url = next(line for line in process.stdout if line.startswith("showing ")).split()[-1]
    with Scene.open(stream) as scene, browser(url) as connection:
        receive(connection, sent(scene.splats(5)))
    process.send_signal(signal.SIGTERM)
    assert process.communicate(timeout=BOUND_S)[1] == ""
    assert process.returncode == 128 + signal.SIGTERM


def test_one_line_says_how_to_install_it(stream: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    message = r"^viser is not installed; install it with pip install '\.\[viser\]' in the swings"
    with Scene.open(stream) as scene, pytest.raises(InvalidError, match=message):
        ViserView(scene)
