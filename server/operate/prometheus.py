"""The server's metrics, for /metrics, by prometheus-client: in one process or in several.

Rule: every label takes its values from a small closed set, never from what a client sent.
"""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import Final

import prometheus_client
from prometheus_client import (
    CollectorRegistry,
    Counter,
    Gauge,
    Histogram,
    generate_latest,
    multiprocess,
    values,
)

CONTENT_TYPE: Final = prometheus_client.CONTENT_TYPE_PLAIN_0_0_4

NAMESPACE: Final = "swings"
"""How the names of all families begin."""

FOLDER_VARIABLE: Final = "PROMETHEUS_MULTIPROC_DIR"

TTFB_BUCKETS_S: Final = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0)

LATE_BUCKETS_S: Final = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0)


class CounterSeries:
    """A named counter with one value for each combination of labels; it only rises.

    What is added waits until `flush`: counting is done for each request, telling once in a while.
    """

    def __init__(self, registry: CollectorRegistry, name: str, help: str, *labels: str) -> None:
        self._counter = Counter(name, help, labels, NAMESPACE, registry=registry)
        self._sample = partial(registry.get_sample_value, f"{NAMESPACE}_{name}_total")
        self._labels = labels
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
        return self._sample(dict(zip(self._labels, values, strict=True))) or 0.0


class Metrics:
    """All metrics of /metrics."""

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
        counter = partial(CounterSeries, registry)
        self.requests = counter("requests", "Responses by route and status code.", "route", "code")
        self.layer_bytes = counter(
            "layer_bytes",
            "Bytes of objects or packets sent, by layer, skip map or keyframe, and by request "
            "type.",
            "via",
            "layer",
        )
        self.packets = counter(
            "play_packets", "Packets sent by plays, by layer, skip map or keyframe.", "layer"
        )
        self.plays = counter("plays", "Finished plays, by outcome.", "outcome")
        self.status_reports = counter(
            "play_status_reports", "Client status reports of plays, by outcome.", "outcome"
        )
        self.cache_hits = counter("cache_hits", "Objects found in memory.")
        self.cache_misses = counter("cache_misses", "Objects read from disk.")
        self.refused = counter(
            "refused", "Connections, plays and requests refused, by reason.", "reason"
        )
        self.timeouts = counter("timeouts", "Connections closed by a timeout, by kind.", "kind")
        self.worker_requests = counter(
            "worker_requests", "Requests from one worker to another, by outcome.", "outcome"
        )
        self.log_dropped = counter(
            "log_dropped", "Log lines dropped because the sink did not accept them."
        )

        # What the values of several living processes make together.
        in_all = partial(Gauge, namespace=NAMESPACE, registry=registry, multiprocess_mode="livesum")
        highest = partial(
            Gauge, namespace=NAMESPACE, registry=registry, multiprocess_mode="livemax"
        )
        self.active_plays = in_all("active_plays", "Plays in progress.")
        self.open_connections = in_all("open_connections", "Open connections.")
        self.cache_bytes = in_all("cache_bytes", "Bytes of objects held in memory.")
        self.shed_layers = highest(
            "shed_layers", "Layers withheld from plays because of load, highest of all workers."
        )
        # Every worker looks at the same streams.
        self.streams = highest("streams", "Streams, by state.", ["state"])

        histogram = partial(Histogram, namespace=NAMESPACE, registry=registry)
        self.ttfb = histogram(
            "ttfb_seconds",
            "Time from a complete request to the first byte of its response, if it had to wait.",
            buckets=TTFB_BUCKETS_S,
        )
        self.loop_late = histogram(
            "loop_late_seconds", "Lateness of the event loop, per sample.", buckets=LATE_BUCKETS_S
        )

    def flush(self) -> None:
        """Counts what was added; the other workers see it from now on."""
        for series in vars(self).values():
            if isinstance(series, CounterSeries):
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
    """Removes the gauges of an ended worker, such as its connections; its counters stay. The
    arbiter calls this before another worker gets the place."""
    multiprocess.mark_process_dead(place, str(folder))
