"""What the server counts, for /metrics, by prometheus-client: in one process or in several.

Rule: every label takes its values from a small closed set, never from what a client sent.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Final, Literal

import prometheus_client
from prometheus_client import CollectorRegistry, generate_latest, multiprocess, values

CONTENT_TYPE: Final = prometheus_client.CONTENT_TYPE_PLAIN_0_0_4

FOLDER_VARIABLE: Final = "PROMETHEUS_MULTIPROC_DIR"

TTFB_BUCKETS_S: Final = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0)

LATE_BUCKETS_S: Final = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0)


class CounterSeries:
    """A named counter with one value for each combination of labels; it only rises.

    What is added waits until `flush`: counting is done for each request, telling once in a while.
    """

    def __init__(self, registry: CollectorRegistry, name: str, help: str, *labels: str) -> None:
        self._name = name
        self._labels = labels
        self._registry = registry
        self._counter = prometheus_client.Counter(name, help, labels, registry=registry)
        self._added: dict[tuple[str, ...], float] = {}

    def add(self, amount: float, *values: str) -> None:
        """Adds `amount`, not negative, to the value of these labels."""
        self._added[values] = self._added.get(values, 0.0) + amount

    def flush(self) -> None:
        """Counts what was added."""
        added, self._added = self._added, {}
        for names, amount in added.items():
            (self._counter.labels(*names) if self._labels else self._counter).inc(amount)

    def value(self, *values: str) -> float:
        """The value in this process."""
        self.flush()
        labels = dict(zip(self._labels, map(str, values), strict=True))
        return self._registry.get_sample_value(self._name, labels) or 0.0


class GaugeSeries:
    """A named value that rises and falls."""

    def __init__(
        self,
        registry: CollectorRegistry,
        merge: Literal["livesum", "livemax"],
        name: str,
        help: str,
        *labels: str,
    ) -> None:
        """merge: what the values of several processes that live make together."""
        self._name = name
        self._labels = labels
        self._registry = registry
        self._gauge = prometheus_client.Gauge(
            name, help, labels, registry=registry, multiprocess_mode=merge
        )
        self._bound: dict[tuple[str, ...], Callable[[float], None]] = {}

    def set(self, amount: float, *values: str) -> None:
        """Sets the value of these labels."""
        found = self._bound.get(values)
        if found is None:
            child = self._gauge.labels(*values) if values or self._labels else self._gauge
            found = self._bound[values] = child.set
        found(amount)

    def value(self, *values: str) -> float:
        """The value in this process."""
        labels = dict(zip(self._labels, map(str, values), strict=True))
        return self._registry.get_sample_value(self._name, labels) or 0.0


class Metrics:
    """Everything that /metrics tells."""

    def __init__(self, folder: Path | None = None, place: int = 0) -> None:
        """folder: where the workers of one server put what they count, each under its `place`; what
        a dead one counted, its successor goes on with. None for a server of one process, that keeps
        it in memory. There can be one such folder in a process."""
        prometheus_client.disable_created_metrics()
        self._folder = folder
        if folder is None:
            values.ValueClass = values.MutexValue
        else:
            os.environ[FOLDER_VARIABLE] = str(folder)
            values.ValueClass = values.MultiProcessValue(lambda: place)
        self._registry = registry = CollectorRegistry()

        self._counters: list[CounterSeries] = []

        def counter(name: str, help: str, *labels: str) -> CounterSeries:
            self._counters.append(CounterSeries(registry, name, help, *labels))
            return self._counters[-1]

        self.requests = counter(
            "swings_requests_total", "Responses by route and status code.", "route", "code"
        )
        self.layer_bytes = counter(
            "swings_layer_bytes_total",
            "Bytes of objects or packets sent, by layer, mask or snapshot, and by request type.",
            "via",
            "layer",
        )
        self.packets = counter(
            "swings_play_packets_total",
            "Packets sent by plays, by layer, mask or snapshot.",
            "layer",
        )
        self.plays = counter("swings_plays_total", "Finished plays, by outcome.", "outcome")
        self.play_news = counter(
            "swings_play_news_total",
            "Client status reports of plays, by outcome.",
            "outcome",
        )
        self.cache_hits = counter("swings_cache_hits_total", "Objects found in memory.")
        self.cache_misses = counter("swings_cache_misses_total", "Objects read from disk.")
        self.refused = counter(
            "swings_refused_total", "Connections, plays and requests refused, by reason.", "reason"
        )
        self.accept_pauses = counter(
            "swings_accept_pauses_total", "Pauses during which no connection could be accepted."
        )
        self.timeouts = counter(
            "swings_timeouts_total", "Connections closed by a timeout, by kind.", "kind"
        )
        self.peer_messages = counter(
            "swings_peer_messages_total",
            "Messages between workers, by outcome.",
            "outcome",
        )
        self.log_dropped = counter(
            "swings_log_dropped_total", "Log lines dropped because the sink did not accept them."
        )
        self.active_plays = GaugeSeries(
            registry, "livesum", "swings_active_plays", "Plays in progress."
        )
        self.open_connections = GaugeSeries(
            registry, "livesum", "swings_open_connections", "Open connections."
        )
        self.cache_bytes = GaugeSeries(
            registry, "livesum", "swings_cache_bytes", "Bytes of objects held in memory."
        )
        self.shed_layers = GaugeSeries(
            registry,
            "livemax",
            "swings_shed_layers",
            "Layers withheld from plays because of load, highest of all workers.",
        )
        # Every worker looks at the same streams.
        self.streams = GaugeSeries(
            registry, "livemax", "swings_streams", "Streams, by state.", "state"
        )
        self.ttfb = prometheus_client.Histogram(
            "swings_ttfb_seconds",
            "Time from a complete request to the first byte of its response, if it had to wait.",
            registry=registry,
            buckets=TTFB_BUCKETS_S,
        )
        self.loop_late = prometheus_client.Histogram(
            "swings_loop_late_seconds",
            "Lateness of the event loop, per sample.",
            registry=registry,
            buckets=LATE_BUCKETS_S,
        )

    def flush(self) -> None:
        """Counts what was added; the other workers see it from now on."""
        for series in self._counters:
            series.flush()

    def text(self) -> str:
        """All families in the Prometheus text format: those of all workers, where there are
        several."""
        self.flush()
        registry = self._registry
        if self._folder is not None:
            registry = CollectorRegistry()
            multiprocess.MultiProcessCollector(registry, str(self._folder))
        return generate_latest(registry).decode()


def forget_worker(folder: Path, place: int) -> None:
    """What a worker that has ended held, such as its connections, is not there any more; what it
    counted stays. The supervisor calls this before the place is given to another worker."""
    multiprocess.mark_process_dead(place, str(folder))
