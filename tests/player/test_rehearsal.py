"""Nothing is compiled or loaded after the stream has been requested."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.commands import ROOT
from tests.support.hosted_streams import write_stream
from tests.support.slots.slot_streams import write_slot_stream

PLAY = """
import json, sys
from pathlib import Path

from numba.core.dispatcher import Dispatcher

from player.config import PlayConfig
from player.run.playback import play
from player.render.renderer import RendererKind
from player.network.fetch import Fetcher
from tests.support.hosted_streams import static_host

def loaded():
    return {
        f"{name}.{key} {signature}"
        for name, module in list(sys.modules.items())
        if name.split(".")[0] in ("codec", "player")
        for key, value in vars(module).items()
        if isinstance(value, Dispatcher)
        for signature in value.signatures
    }

asked = []
get = Fetcher.get

def noting(self, url, limit_bytes):
    asked.append(loaded())
    return get(self, url, limit_bytes)

Fetcher.get = noting
folder, kind = Path(sys.argv[1]), RendererKind(sys.argv[2])
with static_host(folder) as host:
    for name in ("whole", "slots"):
        play(PlayConfig(f"{host}/{name}", capture=folder / f"{name}.out", renderer=kind))
print(json.dumps({"ready": len(asked[0]), "later": sorted(loaded() - asked[0])}))
"""


@pytest.mark.parametrize("kind", ["cpu", "auto"])
def test_kernels_are_ready_before_the_first_request(tmp_path: Path, kind: str) -> None:
    write_stream(tmp_path / "whole", 8)
    write_slot_stream(tmp_path / "slots", 8)
    done = subprocess.run(
        [sys.executable, "-c", PLAY, str(tmp_path), kind],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=200,
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["ready"] > 5
    assert told["later"] == []
