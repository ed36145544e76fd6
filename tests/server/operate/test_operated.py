"""swings-serve as its operator has it: limits, overload, settings, the log and what is counted."""

from __future__ import annotations

import json
import resource
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from tests.server.hostile.serverprocess import Answer, answers_of, exchange, get, server_process
from tests.support.commands import command, environment, run, run_ok
from tests.support.server.running_server import make_stream

OBJECT = "/v1/streams/walk/segments/0/0"
PLAY = "/v1/streams/walk/play?layers=1"


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("root")
    make_stream(root / "walk", 300, title="A walk")
    make_stream(root / "wide", 900, slice_size=2000)
    return root


def ask(port: int, path: str, *lines: str, quiet_s: float = 2.0) -> Answer:
    """The first answer to a GET with these header lines."""
    head = [f"GET {path} HTTP/1.1", "Host: h", "Connection: close", *lines, "", ""]
    data, _ = exchange(port, "\r\n".join(head).encode(), quiet_s=quiet_s)
    return answers_of(data)[0][0]


def begin(stack: ExitStack, port: int, path: str, *lines: str, rcvbuf: int = 0) -> socket.socket:
    """A connection that has asked for `path`, with its answer on the way."""
    sock = stack.enter_context(socket.socket())
    if rcvbuf:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, rcvbuf)
    sock.settimeout(20)
    sock.connect(("127.0.0.1", port))
    sock.sendall("\r\n".join([f"GET {path} HTTP/1.1", "Host: h", *lines, "", ""]).encode())
    return sock


def eventually(holds: Callable[[], bool], seconds: float = 15.0) -> None:
    end_s = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end_s, "it did not happen"
        time.sleep(0.05)


def test_one_address_has_so_many_connections(root: Path, tmp_path: Path) -> None:
    options = "--max-address-connections", 3, "--trusted-proxies", "10.0.0.0/8"
    with server_process(root, tmp_path, *options) as server, ExitStack() as stack:
        time.sleep(0.2)
        held = [
            stack.enter_context(socket.create_connection(("127.0.0.1", server.port)))
            for _ in range(3)
        ]
        eventually(lambda: ask(server.port, "/healthz").status == 429)
        assert ask(server.port, "/healthz").headers["retry-after"] == "5"
        held.pop().close()
        eventually(lambda: ask(server.port, "/healthz").status == 200)


def test_one_client_of_a_proxy_has_so_many_plays(root: Path, tmp_path: Path) -> None:
    one, other = "X-Forwarded-For: 198.51.100.7", "X-Forwarded-For: 198.51.100.8"
    options = "--max-address-plays", 2
    with server_process(root, tmp_path, *options) as server, ExitStack() as stack:
        for _ in range(2):
            assert begin(stack, server.port, PLAY, one).recv(12) == b"HTTP/1.1 200"
        refused = ask(server.port, PLAY, one)
        assert refused.status == 429
        assert int(refused.headers["retry-after"]) > 0
        # What stands left of the proxy's own word is the client's.
        forged = ask(server.port, PLAY, "X-Forwarded-For: 1.2.3.4, 198.51.100.7")
        assert forged.status == 429
        assert begin(stack, server.port, PLAY, other).recv(12) == b"HTTP/1.1 200"
        stack.close()
        eventually(lambda: ask(server.port, f"{PLAY}&until=3", one).status == 200)


def test_a_stranger_cannot_say_who_it_is(root: Path, tmp_path: Path) -> None:
    options = "--max-address-plays", 1, "--trusted-proxies", "10.0.0.0/8"
    with server_process(root, tmp_path, *options) as server, ExitStack() as stack:
        begin(stack, server.port, PLAY, "X-Forwarded-For: 198.51.100.7").recv(12)
        assert ask(server.port, PLAY, "X-Forwarded-For: 198.51.100.8").status == 429


def test_connections_above_the_limit_wait_and_are_served(root: Path, tmp_path: Path) -> None:
    with server_process(root, tmp_path, "--max-connections", 4) as server, ExitStack() as stack:
        held = [
            stack.enter_context(socket.create_connection(("127.0.0.1", server.port)))
            for _ in range(4)
        ]
        time.sleep(0.5)
        waiting = [begin(stack, server.port, "/healthz", "Connection: close") for _ in range(8)]
        time.sleep(0.5)
        for sock in waiting:
            sock.setblocking(False)
            with pytest.raises(BlockingIOError):
                sock.recv(1)
            sock.settimeout(20)
        for sock in held:
            sock.close()
        assert [sock.recv(12) for sock in waiting] == [b"HTTP/1.1 200"] * 8


@pytest.mark.realtime
@pytest.mark.skipif(sys.platform != "linux", reason="limits of open files as on Linux")
def test_idle_clients_beyond_all_descriptors_are_waited_out_quietly(
    root: Path, tmp_path: Path
) -> None:
    """Without room for 150 connections the log stays short, and who comes then is served soon."""
    log = tmp_path / "serve.log"
    with open(log, "w") as out:
        process = subprocess.Popen(
            command("swings-serve", root, "--port", 0, "--request-timeout-s", 3),
            env=environment(),
            stdout=subprocess.PIPE,
            stderr=out,
            text=True,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (128, 128)),
        )
    with ExitStack() as stack:
        stack.callback(process.wait)
        stack.callback(process.kill)
        assert process.stdout is not None
        stack.enter_context(process.stdout)
        port = int(process.stdout.readline().rsplit(":", 1)[1])
        for _ in range(150):
            stack.enter_context(socket.create_connection(("127.0.0.1", port)))
        time.sleep(1)
        began_s = time.monotonic()
        last = begin(stack, port, "/healthz", "Connection: close")
        assert last.recv(12) == b"HTTP/1.1 200"
        assert time.monotonic() - began_s < 12
        time.sleep(0.5)
        assert len(log.read_text().splitlines()) <= 10, log.read_text()[:2000]


def layers_of(line: str) -> float:
    return float(line.split(" layers=")[1].split()[0])


def test_too_much_egress_sheds_layers_then_refuses_and_recovers(root: Path, tmp_path: Path) -> None:
    options = "--max-egress-bps", 6e6, "--smooth-s", 0.3, "--recover-per-s", 0.5
    with server_process(root, tmp_path, *options) as server, ExitStack() as stack:
        # Far more than that is asked for, and taken as fast as it comes.
        def shed() -> float:
            text = get(server.port, "/metrics").body.decode()
            return next(
                sample.value
                for family in text_string_to_metric_families(text)
                for sample in family.samples
                if sample.name == "swings_shed_layers"
            )

        assert shed() == 0
        script = (
            "import sys, urllib.request as u\n"
            "with u.urlopen(sys.argv[1]) as r:\n"
            "    while r.read(65536): pass\n"
        )
        url = f"http://127.0.0.1:{server.port}/v1/streams/wide/play"
        for _ in range(3):
            taker = subprocess.Popen([sys.executable, "-c", script, url])
            stack.callback(taker.wait)
            stack.callback(taker.kill)
        eventually(lambda: shed() >= 1)
        refused: list[Answer] = []

        def is_refused() -> bool:
            answer = ask(server.port, f"{PLAY}&until=2", quiet_s=0.5)
            refused.append(answer)
            return answer.status == 503

        eventually(is_refused)
        assert int(refused[-1].headers["retry-after"]) > 0
        stack.close()
        eventually(lambda: shed() == 0)
        assert ask(server.port, f"{PLAY}&until=2").status == 200


def test_settings_come_from_a_file_the_environment_and_options(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "serve.toml"
    file.write_text("max_plays = 1\nkeepalive_timeout_s = 7.0\n")
    monkeypatch.setenv("SWINGS_SERVE_KEEPALIVE_TIMEOUT_S", "9")
    said = run_ok("swings-serve", root, "--config", file, "--check-config")
    assert "max_plays = 1\n" in said
    assert "keepalive_timeout_s = 9.0\n" in said
    said = run_ok("swings-serve", root, "--config", file, "--max-plays", 3, "--check-config")
    assert "max_plays = 3\n" in said
    with server_process(root, tmp_path, "--config", file) as server, ExitStack() as stack:
        assert begin(stack, server.port, PLAY).recv(12) == b"HTTP/1.1 200"
        assert ask(server.port, PLAY).status == 503
    file.write_text("max_play = 1\n")
    done = run("swings-serve", root, "--config", file, "--check-config")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "max_plays" in done.stderr


def test_times_without_an_end_are_refused_in_one_line(root: Path) -> None:
    for option, value in (("--write-timeout-s", "inf"), ("--keepalive-timeout-s", "nan")):
        done = run("swings-serve", root, option, value)
        assert done.returncode == 2
        assert "Traceback" not in done.stderr
        assert option[2:].replace("-", "_") in done.stderr


def test_every_line_of_a_json_log_is_json(root: Path, tmp_path: Path) -> None:
    escapes = '/\x1b[2J%1b]0;x%07"quoted"'
    with server_process(root, tmp_path, "--log", "json") as server:
        ask(server.port, OBJECT)
        ask(server.port, f"{PLAY}&until=2")
        exchange(server.port, f"GET {escapes} HTTP/1.1\r\nHost: h\r\n\r\n".encode())
        ask(server.port, "/%1b%5b2J", "User-Agent: \t\xff".encode("latin-1").decode("latin-1"))
        time.sleep(0.6)
    lines = [line for line in server.log_lines() if not line.startswith("serving http")]
    told = [json.loads(line) for line in lines]
    assert all(line.isascii() and line.isprintable() for line in lines)
    paths = [one.get("path") for one in told]
    assert OBJECT in paths
    play = next(one for one in told if str(one.get("path", "")).endswith("/play"))
    assert play["outcome"] == "complete"


def test_any_worker_tells_what_both_have_counted(root: Path, tmp_path: Path) -> None:
    with server_process(root, tmp_path, "--workers", 2) as server:
        for _ in range(40):
            assert get(server.port, "/healthz").status == 200

        def counted() -> float:
            text = get(server.port, "/metrics").body.decode()
            return sum(
                sample.value
                for family in text_string_to_metric_families(text)
                for sample in family.samples
                if sample.name == "swings_requests_total" and sample.labels["route"] == "/healthz"
            )

        eventually(lambda: counted() == 40)
        assert [counted() for _ in range(6)] == [40] * 6  # whoever is asked


@pytest.mark.realtime
def test_plays_that_are_stuck_do_not_keep_a_server_that_shall_end(
    root: Path, tmp_path: Path
) -> None:
    with server_process(root, tmp_path, "--shutdown-timeout-s", 2) as server, ExitStack() as stack:
        for _ in range(50):
            begin(stack, server.port, "/v1/streams/wide/play?layers=4", rcvbuf=4096).recv(12)
        began_s = time.monotonic()
        subprocess.run(["kill", f"-{signal.SIGTERM.value}", str(server.pid)], check=True)
        eventually(lambda: " outcome=" in server.log.read_text())
        eventually(lambda: not is_running(server.pid))
        assert time.monotonic() - began_s < 5


def is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False
