"""What /metrics says, read back with the parser of prometheus-client."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

from prometheus_client.parser import text_string_to_metric_families

from server.operate.prometheus import Metrics, forget_worker
from tests.support.commands import ROOT

FAMILIES = {
    "swings_requests",
    "swings_layer_bytes",
    "swings_play_packets",
    "swings_plays",
    "swings_play_news",
    "swings_active_plays",
    "swings_cache_bytes",
    "swings_cache_hits",
    "swings_cache_misses",
    "swings_ttfb_seconds",
    "swings_open_connections",
    "swings_refused",
    "swings_accept_pauses",
    "swings_timeouts",
    "swings_shed_layers",
    "swings_loop_late_seconds",
    "swings_log_dropped",
    "swings_peer_messages",
    "swings_streams",
}


def samples(text: str) -> dict[str, float]:
    """Values by name and labels, as in `name{a=b}`."""
    found = {}
    for family in text_string_to_metric_families(text):
        for sample in family.samples:
            labels = ",".join(f"{key}={value}" for key, value in sorted(sample.labels.items()))
            found[f"{sample.name}{{{labels}}}" if labels else sample.name] = sample.value
    return found


def test_every_family_is_in_the_text() -> None:
    families = {family.name for family in text_string_to_metric_families(Metrics().text())}
    assert families == FAMILIES


def test_what_was_counted_is_told() -> None:
    metrics = Metrics()
    metrics.requests.add(1, "/", "200")
    metrics.requests.add(2, "/", "200")
    metrics.requests.add(1, "/", "404")
    metrics.cache_hits.add(5)
    metrics.active_plays.set(7)
    metrics.active_plays.set(3)
    metrics.streams.set(2, "served")
    metrics.ttfb.observe(0.003)
    metrics.ttfb.observe(70.0)
    told = samples(metrics.text())
    assert told["swings_requests_total{code=200,route=/}"] == 3
    assert told["swings_requests_total{code=404,route=/}"] == 1
    assert told["swings_cache_hits_total"] == 5
    assert told["swings_cache_misses_total"] == 0
    assert told["swings_active_plays"] == 3
    assert told["swings_streams{state=served}"] == 2
    assert told["swings_ttfb_seconds_bucket{le=0.0025}"] == 0
    assert told["swings_ttfb_seconds_bucket{le=0.005}"] == 1
    assert told["swings_ttfb_seconds_count"] == 2
    assert metrics.requests.value("/", "200") == 3
    assert metrics.streams.value("served") == 2
    assert "_created" not in metrics.text()


def test_two_servers_in_one_process_count_apart() -> None:
    one, other = Metrics(), Metrics()
    one.cache_hits.add(1)
    assert (one.cache_hits.value(), other.cache_hits.value()) == (1, 0)


def worker(folder: Path, place: int, then: str = "") -> subprocess.Popen[str]:
    """A process that counts, says so, and waits."""
    code = (
        "import sys, time; from pathlib import Path\n"
        "from server.operate.prometheus import Metrics\n"
        f"metrics = Metrics(Path({str(folder)!r}), {place})\n"
        "metrics.requests.add(10, '/', '200')\n"
        f"metrics.active_plays.set({place} + 1)\n"
        f"metrics.shed_layers.set({place})\n"
        "metrics.streams.set(4, 'served')\n"
        "metrics.ttfb.observe(0.02)\n"
        "metrics.flush()\n"
        f"{then}\n"
        "print('counted', flush=True)\n"
        "time.sleep(60)\n"
    )
    environment = {k: v for k, v in os.environ.items() if k != "PROMETHEUS_MULTIPROC_DIR"}
    process = subprocess.Popen(
        [sys.executable, "-c", code], cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "counted\n"
    return process


def told_by_all(folder: Path) -> dict[str, float]:
    """What another worker tells of all of them."""
    code = (
        "from pathlib import Path; from server.operate.prometheus import Metrics\n"
        f"print(Metrics(Path({str(folder)!r}), 9).text(), end='')\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return samples(done.stdout)


def killed(process: subprocess.Popen[str]) -> None:
    with process:
        process.send_signal(signal.SIGKILL)


def test_any_worker_tells_what_all_have_counted_and_the_dead_hold_nothing(tmp_path: Path) -> None:
    first, second = worker(tmp_path, 0), worker(tmp_path, 1)
    told = told_by_all(tmp_path)
    assert told["swings_requests_total{code=200,route=/}"] == 20
    assert told["swings_active_plays"] == 3
    assert told["swings_shed_layers"] == 1
    assert told["swings_streams{state=served}"] == 4
    assert told["swings_ttfb_seconds_bucket{le=0.025}"] == 2
    assert told["swings_ttfb_seconds_count"] == 2

    killed(second)
    forget_worker(tmp_path, 1)
    told = told_by_all(tmp_path)
    assert told["swings_requests_total{code=200,route=/}"] == 20
    assert told["swings_active_plays"] == 1

    # Whoever takes its place goes on counting, and no file is left over however often that is.
    files = set(os.listdir(tmp_path))
    for n in range(3):
        killed(worker(tmp_path, 1))
        forget_worker(tmp_path, 1)
        assert told_by_all(tmp_path)["swings_requests_total{code=200,route=/}"] == 30 + 10 * n
    assert set(os.listdir(tmp_path)) == files
    killed(first)
