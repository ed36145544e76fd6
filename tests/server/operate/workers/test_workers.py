"""swings-serve with workers: a client's request may reach another worker, or a successor."""

from __future__ import annotations

import itertools
import os
import re
import shutil
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from http.client import HTTPConnection, HTTPException, HTTPResponse
from pathlib import Path
from subprocess import CompletedProcess

import pytest

from codec.stream.playrecord import EndRecord, ErrorRecord, Record
from server.abr.clientstatus import PLAY_HEADER, RATE_HEADER
from server.http.errors import ServerError
from server.operate.sign.signing import Signer, add_key, read_keys
from server.operate.workers import SHARED_MEMORY, WorkerFolder
from server.serving import check_files
from server.state.config import ServerConfig
from tests.server.hostile.serverprocess import Comers, ServerProcess, ask, figures, server_process
from tests.support.commands import run
from tests.support.server.certificates import make_certificate
from tests.support.server.running_server import births_with_layer_0, make_stream, parse_records
from tests.support.suite.once import made_once
from tests.support.waiting import BOUND_S, wait_until

pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="several workers need Linux"
)

JSON = ("--log", "json")

HANGING = """
class Hanging:
    def mends(self, *_):
        return False

    def choose(self, *_):
        while True:
            pass
"""
"""A policy of somebody's own."""


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    def make(folder: Path) -> None:
        # 200 s, of which 6 s are sent at once: no play of it ends by itself.
        make_stream(folder / "long", 600, slice_size=200, fps=3)
        make_stream(folder / "big", 5, slice_size=20_000)

    return made_once(tmp_path_factory, "workers", make)


@contextmanager
def workers(root: Path, folder: Path, *options: object) -> Iterator[ServerProcess]:
    """A server with two workers that are ready."""
    with server_process(root, folder, "--workers", 2, *JSON, *options) as server:
        wait_until(lambda: len(server.events("worker_ready")) == 2)
        yield server


class Play:
    """A running play, read in a thread."""

    def __init__(self, server: ServerProcess, query: str = "") -> None:
        self._connection = HTTPConnection("127.0.0.1", server.port, timeout=BOUND_S)
        self._connection.request("GET", f"/v1/streams/long/play{query}")
        self.response = self._connection.getresponse()
        assert self.response.status == 200
        self.token = self.response.headers[PLAY_HEADER]
        self.place = int(self.token.partition("-")[0])
        self.pieces: list[bytes] = []
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        with suppress(OSError, HTTPException):
            while piece := self.response.read1(65536):
                self.pieces.append(piece)

    @property
    def is_playing(self) -> bool:
        return self._reader.is_alive()

    def records(self) -> list[Record]:
        """All received records, after the response has ended."""
        self._reader.join(BOUND_S)
        return parse_records(self.pieces)

    def close(self) -> None:
        if self._connection.sock is not None:
            with suppress(OSError):  # it has ended
                self._connection.sock.shutdown(socket.SHUT_RDWR)
        self._reader.join(BOUND_S)
        self.response.close()
        self._connection.close()


def answer_of(
    connection: HTTPConnection, path: str, token: str = "", report: bytes | None = None
) -> HTTPResponse:
    """The answer, read whole, to a GET with the previous play's token, or to a status report."""
    method = "GET" if report is None else "POST"
    connection.request(method, f"/v1/streams/{path}", report, {PLAY_HEADER: token})
    answer = connection.getresponse()
    answer.read()
    return answer


def connections_to_both(server: ServerProcess, stack: ExitStack) -> dict[int, HTTPConnection]:
    """By worker a connection to it that is kept."""
    found: dict[int, HTTPConnection] = {}
    for _ in range(300):
        one = HTTPConnection("127.0.0.1", server.port, timeout=BOUND_S)
        answer = answer_of(one, "long/play?until=1&layers=1")
        place = int(answer.headers[PLAY_HEADER].partition("-")[0])
        if place in found:
            one.close()
            continue
        found[place] = stack.enter_context(closing(one))
        if len(found) == 2:
            return found
    raise AssertionError("one worker takes all connections")


def test_a_status_report_may_reach_any_worker(root: Path, tmp_path: Path) -> None:
    with workers(root, tmp_path) as server, ExitStack() as stack:
        to_both = connections_to_both(server, stack)

        def tell(place: int, token: str, body: bytes) -> tuple[int, str | None]:
            answer = answer_of(to_both[place], f"long/play/{token}", report=body)
            return answer.status, answer.headers[RATE_HEADER]

        places = set[int]()
        while places != {0, 1}:
            with closing(Play(server)) as play:
                if play.place in places:
                    continue
                places.add(play.place)
                for place in to_both:
                    # The client reports progress, so that more is sent until the link is measured.
                    at = map(b'{"frame": %d}'.__mod__, itertools.count(1))
                    wait_until(lambda p=place, t=play.token, a=at: tell(p, t, next(a))[1])
                    status, rate = tell(place, play.token, b'{"frame": 1}')
                    assert status == 204
                    assert rate is not None
                    assert int(rate) > 1_000_000
                    assert tell(place, play.token, b"nonsense") == (400, None)
            for place in to_both:
                wait_until(lambda p=place, t=play.token: tell(p, t, b'{"frame": 1}')[0] == 404)
        # What it counts it counts once, whoever was asked.
        assert figures(server.port)["swings_play_status_reports_total", "refused"] >= 1


def continued(server: ServerProcess, births: list[int], frame: int) -> None:
    """Asserts that a play that broke off after `births` goes on at `frame`, with no gap."""
    query = f"?from={frame}&until={frame + 10}&layers=2"
    with closing(Play(server, query)) as rest:
        more = rest.records()
    assert isinstance(more[-1], EndRecord)
    new = [birth for birth in births_with_layer_0(more) if birth >= frame]
    assert births + new == list(range(births[0], frame + 10))


def test_renewed_workers_say_where_to_go_on_and_nobody_is_refused(
    root: Path, tmp_path: Path
) -> None:
    with workers(root, tmp_path) as server, ExitStack() as stack:
        plays = [stack.enter_context(closing(Play(server, "?layers=2"))) for _ in range(4)]
        for play in plays:
            wait_until(lambda p=play: sum(map(len, p.pieces)) > 20_000)

        def come() -> None:
            assert ask(server.port, "/v1/streams/long/manifest.json").status == 200

        with Comers(come) as comers:
            for count in (2, 4):  # a second time, to show that there is room
                os.kill(server.pid, signal.SIGHUP)
                wait_until(lambda n=count: len(server.events("worker_ended")) == n)
        assert comers.troubles == []
        assert max(line["worker"] for line in server.events("worker_ready")) <= 3
        for play in plays:
            records = play.records()
            last = records[-1]
            assert isinstance(last, ErrorRecord)
            match = re.fullmatch(
                r"the server is stopping; play again from frame (\d+)", last.message
            )
            assert match, last
            births, frame = births_with_layer_0(records), int(match[1])
            assert births[-1] == frame - 1
        continued(server, births, frame)


def test_plays_of_a_worker_that_dies_go_on_at_another(root: Path, tmp_path: Path) -> None:
    with workers(root, tmp_path) as server, ExitStack() as stack:
        pids = {line["worker"]: line["pid"] for line in server.events("worker_ready")}
        plays = [stack.enter_context(closing(Play(server, "?layers=2")))]
        while len({play.place for play in plays}) < 2:
            plays.append(stack.enter_context(closing(Play(server, "?layers=2"))))
        play = plays[0]
        wait_until(lambda: sum(map(len, play.pieces)) > 20_000)
        os.kill(pids[play.place], signal.SIGKILL)
        births = births_with_layer_0(play.records())
        wait_until(lambda: len(server.events("worker_ready")) == 3)
        assert [line["pid"] for line in server.events("worker_ended")] == [pids[play.place]]
        continued(server, births, births[-1] + 1)
        assert all(one.is_playing for one in plays if one.place != play.place)


def test_keys_are_read_again_and_broken_ones_are_found_before(root: Path, tmp_path: Path) -> None:
    """As `systemctl reload` does: --check-config, then SIGHUP."""
    keys = tmp_path / "keys"
    add_key(keys)

    def status() -> int:
        signed = Signer(read_keys(keys)).sign("long", round(time.time()) + 600)
        return ask(server.port, f"{signed}/v1/streams/long/manifest.json").status

    def checked() -> CompletedProcess[str]:
        return run("swings-serve", root, "--keys", keys, "--check-config")

    with workers(root, tmp_path, "--keys", keys) as server:
        assert status() == 200
        before = keys.read_text()
        keys.write_text("no key")
        refused = checked()
        assert (refused.returncode, refused.stderr.count("\n")) == (1, 1)
        assert "line 1 is not NAME:SECRET" in refused.stderr
        keys.write_text(before)
        add_key(keys)
        assert checked().returncode == 0
        assert status() == 403  # by its newest key, which the server has not read
        os.kill(server.pid, signal.SIGHUP)
        wait_until(lambda: len(server.events("worker_ended")) == 2)
        assert status() == 200
        keys.write_text("no key")
        os.kill(server.pid, signal.SIGHUP)  # unchecked: the server ends, and says why
        assert server.process.wait(BOUND_S) == 4
        assert "line 1 is not NAME:SECRET" in server.log.read_text()


def test_a_broken_certificate_is_named(tmp_path: Path) -> None:
    cert, key = make_certificate(tmp_path)
    check_files(ServerConfig(tls_cert=cert, tls_key=key))
    cert.write_text("no certificate")
    with pytest.raises(ServerError, match="no valid certificate"):
        check_files(ServerConfig(tls_cert=cert, tls_key=key))


def test_a_folder_called_gunicorn_and_a_cleared_tmpdir_change_nothing(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, temporary = tmp_path / "here", tmp_path / "t"
    (here / "gunicorn").mkdir(parents=True)
    (here / "gunicorn" / "__init__.py").write_text("raise SystemExit('not this one')\n")
    temporary.mkdir()
    monkeypatch.chdir(here)
    monkeypatch.setenv("TMPDIR", str(temporary))
    with workers(root, tmp_path) as server, closing(Play(server, "?layers=2")) as play:
        assert [*temporary.iterdir()] == [] or SHARED_MEMORY is None
        temporary.rename(tmp_path / "gone")
        (worker,) = (line["pid"] for line in server.events("worker_ready")[:1])
        os.kill(worker, signal.SIGKILL)
        wait_until(lambda: len(server.events("worker_ready")) == 3)
        assert figures(server.port)["swings_active_plays",] == play.is_playing
    others = [line for line in server.log_lines() if not line.startswith("{")]
    assert others == [f"serving http://127.0.0.1:{server.port}"]


def test_a_hanging_worker_says_where_and_is_replaced(root: Path, tmp_path: Path) -> None:
    (policy := tmp_path / "hanging.py").write_text(HANGING)
    options = "--policy", f"{policy}:Hanging", "--worker-timeout-s", 2
    with workers(root, tmp_path, *options) as server:
        with closing(HTTPConnection("127.0.0.1", server.port)) as client:
            client.request("GET", "/v1/streams/long/play")
            wait_until(lambda: len(server.events("worker_ready")) == 3)
        assert ask(server.port, "/healthz").status == 200
        assert re.search(r"the event loop hangs in [^\n]*hanging\.py:\d+", server.log.read_text())


def test_what_a_killed_server_left_is_removed_by_the_next(tmp_path: Path) -> None:
    dead = WorkerFolder(str(tmp_path))
    alive = WorkerFolder(str(tmp_path))
    assert dead.path.exists()
    os.close(dead._lock)  # as the kernel does
    after = WorkerFolder(str(tmp_path))
    assert {*tmp_path.iterdir()} == {alive.path, after.path}
    shutil.rmtree(after.path)
    after.make()
    assert after.path.stat().st_mode & 0o777 == 0o700


def test_under_load_all_workers_know_the_tokens_of_all_once_and_no_others(
    root: Path, tmp_path: Path
) -> None:
    # Each response overloads a worker for some seconds.
    options = "--max-egress-bps", 1, "--shed-from", 0.8, "--refuse-from", 0.95
    query = "?until=1&layers=1"
    with workers(root, tmp_path, *options) as server, ExitStack() as stack:
        with closing(Play(server, query)) as play:
            before = play.token
        os.kill(server.pid, signal.SIGHUP)
        wait_until(lambda: len(server.events("worker_ended")) == 2)
        with closing(Play(server, query)) as play:
            after = play.token
        admitted = []
        for one in connections_to_both(server, stack).values():

            def is_full(one: HTTPConnection = one) -> bool:
                for _ in range(20):
                    answer_of(one, "big/segments/0/0")
                return answer_of(one, f"long/play{query}").status == 503

            wait_until(is_full)
            altered = before[:-1] + ("B" if before[-1] == "A" else "A")
            for token in ("0-made_up_by_a_client_0000", altered, "nonsense"):
                answer_of(one, "big/segments/0/0")
                assert answer_of(one, f"long/play{query}", token).status == 503
            statuses = []
            for token in (before, after):
                answer_of(one, "big/segments/0/0")
                statuses.append(answer_of(one, f"long/play{query}", token).status)
            admitted.append(statuses)
        # Of a worker that has ended, nobody knows what its tokens were used for.
        assert admitted == [[200, 200], [200, 503]]
