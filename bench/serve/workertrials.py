"""Kills, stops and starves the workers of a server, one trial after the other: only what a process
held that died may be lost.

Usage: scripts/bench workertrials [--only NAME ...]

Each trial starts a server of two workers and clients that ask it all the time. A trial fails if a
request fails, a play ends, or nothing serves afterwards. `tmpdir full` mounts a file system of one
megabyte, and needs root. Prints a table; exits with 1 if a trial failed.
"""

from __future__ import annotations

import os
import resource
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from codec.console import run_command
from codec.errors import SwingsError
from server.operate.sign.signing import add_key
from server.operate.workers import SHARED_MEMORY
from tests.server.hostile.serverprocess import Comers, ServerProcess, ask, figures, server_process
from tests.support.commands import run
from tests.support.server.running_server import make_stream
from tests.support.waiting import wait_until

MANIFEST = "/v1/streams/long/manifest.json"
PLAY = b"GET /v1/streams/long/play?layers=1 HTTP/1.1\r\nHost: h\r\n\r\n"
RENEWALS, RENEWAL_GAP_S = 60, 0.03
NUM_PLAYS = 12
NUM_SLOW = 1000
"""Clients that begin a request, or read nothing."""
BROKEN_KEYS = ("empty", "junk", "gone", "open to others", "a folder", "a pipe")


@dataclass
class Trial:
    """A server of two workers, and what came of its clients."""

    server: ServerProcess
    folder: Path
    plays: list[socket.socket] = field(default_factory=list)

    @property
    def workers(self) -> list[int]:
        """The processes of the workers."""
        listed = Path(f"/proc/{self.server.pid}/task/{self.server.pid}/children").read_text()
        return [int(pid) for pid in listed.split()]

    def check_served(self, at_once: int = 2) -> None:
        """Waits for that many workers that are ready, and asks them."""
        wait_until(lambda: len(self.workers) == at_once)
        for _ in range(20):
            if (status := ask(self.server.port, MANIFEST).status) != 200:
                raise SwingsError(f"a manifest is {status}")
        counted = figures(self.server.port)
        if not sum(n for (name, *_), n in counted.items() if name == "swings_requests_total"):
            raise SwingsError("/metrics counts nothing")

    def play(self) -> None:
        """Begins plays, which go on."""
        for _ in range(NUM_PLAYS):
            self.plays.append(socket.create_connection(("127.0.0.1", self.server.port), 30))
            self.plays[-1].sendall(PLAY)
            if not self.plays[-1].recv(1 << 16).startswith(b"HTTP/1.1 200 "):
                raise SwingsError("a play was refused")

    def check_plays(self) -> None:
        """Raises SwingsError if one of the plays has ended."""
        ended = 0
        for play in self.plays:
            play.setblocking(False)
            try:
                while piece := play.recv(1 << 20):
                    ended += piece.endswith(b"0\r\n\r\n")
                ended += not piece
            except BlockingIOError:
                pass
            except ConnectionError:
                ended += 1
        if ended:
            raise SwingsError(f"{ended} of {len(self.plays)} plays ended")


def renewed(trial: Trial) -> str:
    for _ in range(RENEWALS):
        os.kill(trial.server.pid, signal.SIGHUP)
        time.sleep(RENEWAL_GAP_S)
    trial.check_served()
    return f"{RENEWALS} SIGHUP in {RENEWALS * RENEWAL_GAP_S:.1f} s"


def killed(trial: Trial) -> str:
    for _ in range(10):
        trial.check_served()
        os.kill(trial.workers[0], signal.SIGKILL)
    trial.check_served()
    return "10 workers killed; requests of the worker that died may fail"


def stopped(trial: Trial) -> str:
    began_s, pid = time.monotonic(), trial.workers[0]
    os.kill(pid, signal.SIGSTOP)
    wait_until(lambda: pid not in trial.workers)
    trial.check_served()
    return f"a worker stopped: another after {time.monotonic() - began_s:.1f} s"


def arbiter_stopped(trial: Trial) -> str:
    trial.play()
    os.kill(trial.server.pid, signal.SIGSTOP)
    time.sleep(7)
    trial.check_plays()
    os.kill(trial.server.pid, signal.SIGCONT)
    trial.check_served()
    trial.check_plays()
    return "gunicorn's first process stopped for 7 s"


def tmpdir_cleared(trial: Trial) -> str:
    trial.play()
    shutil.rmtree(trial.folder / "tmp")
    figures(trial.server.port)
    trial.check_plays()
    os.kill(trial.workers[0], signal.SIGKILL)
    trial.check_served()
    return "TMPDIR removed, then a worker killed"


def tmpdir_full(trial: Trial) -> str:
    try:
        with open(trial.folder / "tmp" / "filler", "wb") as filler:
            while True:
                filler.write(bytes(1 << 16))
                filler.flush()
    except OSError:
        pass
    for path in (MANIFEST, "/v1/streams/nobody", "/metrics", "/v1/streams/long/index.bin", "/"):
        for method in ("GET", "HEAD", "PUT"):
            ask(trial.server.port, path, {"Range": "bytes=0-9"}, method)
    trial.play()
    trial.check_served()
    trial.check_plays()
    return "TMPDIR full; refusals of all kinds, and plays"


def slow(trial: Trial) -> str:
    with ExitStack() as stack:
        for number in range(NUM_SLOW):
            client = socket.create_connection(("127.0.0.1", trial.server.port), 30)
            stack.enter_context(closing(client))
            client.sendall(b"GET / HTTP/1.1\r\nX: " if number % 2 else PLAY)
        trial.check_served()
    trial.check_served()
    return f"{NUM_SLOW} clients, half of a head or a play that nobody reads"


TRIALS = {
    "renewed": renewed,
    "killed": killed,
    "stopped": stopped,
    "arbiter stopped": arbiter_stopped,
    "tmpdir cleared": tmpdir_cleared,
    "tmpdir full": tmpdir_full,
    "slow": slow,
}
TOLERANT = ("killed", "stopped")
"""Trials in which requests of the worker in question may fail."""


@contextmanager
def on_trial(name: str, root: Path) -> Iterator[Trial]:
    """A server with a TMPDIR of its own."""
    with tempfile.TemporaryDirectory(dir=SHARED_MEMORY) as made, ExitStack() as stack:
        folder = Path(made)
        (folder / "tmp").mkdir()
        if name == "tmpdir full":
            words = ["mount", "-t", "tmpfs", "-o", "size=1m", "none", str(folder / "tmp")]
            subprocess.run(words, check=True)
            stack.callback(subprocess.run, ["umount", str(folder / "tmp")], check=True)
        before = os.environ.get("TMPDIR")
        os.environ["TMPDIR"] = str(folder / "tmp")
        options = ("--workers", 2, "--worker-timeout-s", 3, "--max-address-plays", 10_000)
        more = ("--max-plays", 10_000, "--max-address-connections", 4000)
        try:
            server = stack.enter_context(server_process(root, folder, *options, *more))
        finally:
            os.environ.pop("TMPDIR") if before is None else os.environ.update(TMPDIR=before)
        trial = Trial(server, folder)
        trial.check_served()
        yield trial
        for play in trial.plays:
            play.close()


def damage(path: Path, what: str) -> None:
    """Makes of a key file one that cannot be used."""
    if what == "empty":
        path.write_text("")
    elif what == "junk":
        path.write_bytes(b"\x00\xff" * 100)
    elif what == "open to others":
        path.chmod(0o644)
    else:
        path.unlink()
        if what == "a folder":
            path.mkdir()
        if what == "a pipe":
            os.mkfifo(path)


def broken_keys(root: Path) -> str:
    """Checks that --check-config names keys that cannot be used."""
    with tempfile.TemporaryDirectory() as made:
        for what in BROKEN_KEYS:
            path = Path(made) / what
            add_key(path)
            damage(path, what)
            done = run("swings-serve", root, "--keys", path, "--check-config")
            if done.returncode != 1 or done.stderr.count("\n") != 1:
                raise SwingsError(f"keys {what}: {done.returncode}, {done.stderr[-200:]!r}")
    return f"{len(BROKEN_KEYS)} kinds of broken key files, each one line of --check-config"


def arbiter_killed(root: Path) -> str:
    """Nothing may stay of a server whose first process is killed."""
    with on_trial("", root) as trial:
        workers, port = trial.workers, trial.server.port
        os.kill(trial.server.pid, signal.SIGKILL)
        trial.server.process.wait()
        began_s = time.monotonic()
        wait_until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in workers))
        ended_s = time.monotonic() - began_s
    with socket.create_server(("127.0.0.1", port)):
        pass
    with on_trial("", root):
        left = len([*Path(SHARED_MEMORY or tempfile.gettempdir()).glob("swings-serve-*")])
        if left != 1:
            raise SwingsError(f"{left} folders of workers beside the own one")
    return f"gunicorn's first process killed: workers gone after {ended_s:.1f} s, nothing left"


ALONE = {"broken keys": broken_keys, "arbiter killed": arbiter_killed}
"""Trials that start what they need."""


def tried(name: str, root: Path) -> tuple[str, list[float], list[str]]:
    """Runs a trial; gives its description, the times of the requests beside it, seconds, and the
    troubles of those that failed."""
    if name in ALONE:
        return ALONE[name](root), [], []
    times_s: list[float] = []
    with on_trial(name, root) as trial:

        def come() -> None:
            began_s = time.monotonic()
            status = ask(trial.server.port, MANIFEST).status
            times_s.append(time.monotonic() - began_s)
            if status != 200:
                raise SwingsError(f"a manifest is {status}")

        with Comers(come) as comers:
            said = TRIALS[name](trial)
    return said, times_s, comers.troubles


@dataclass(frozen=True, slots=True)
class TrialsConfig:
    """Which trials."""

    only: tuple[str, ...] = (*TRIALS, *ALONE)
    """Names of trials."""


def main(config: TrialsConfig) -> None:
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    table = Table("trial", "what was done", "requests", "failed", "longest, ms", box=box.SIMPLE)
    lost = []
    with tempfile.TemporaryDirectory() as made:
        root = Path(made) / "root"
        make_stream(root / "long", 600, slice_size=200, fps=3)
        for name in config.only:
            try:
                said, times_s, troubles = tried(name, root)
            except (SwingsError, AssertionError, OSError) as error:
                said, times_s, troubles = f"FAILED: {error}", [], []
                lost.append(f"{name}: {error}")
            if troubles and name not in TOLERANT:
                lost.append(f"{name}: {troubles[0]}")
            longest = f"{1e3 * max(times_s):.0f}" if times_s else "-"
            table.add_row(name, said, str(len(times_s)), str(len(troubles)), longest)
    Console().print(table)
    if lost:
        raise SwingsError("; ".join(lost))


if __name__ == "__main__":
    run_command(TrialsConfig, main, "workertrials", __doc__ or "")
