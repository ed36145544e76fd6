"""Counters of the server, written in the Prometheus text format.

Rule: every label takes its values from a small closed set, never from what a client sent.
"""

from __future__ import annotations

from collections import Counter

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"

Labels = tuple[str, ...]


class CounterFamily:
    """A named counter with one value for each combination of labels; it only rises."""

    kind = "counter"

    def __init__(self, name: str, help: str, *labels: str) -> None:
        self.name = name
        self.help = help
        self.labels = labels
        self._values: Counter[Labels] = Counter()

    def add(self, amount: int, *values: str) -> None:
        if len(values) != len(self.labels):
            raise ValueError(f"{self.name} takes labels {self.labels}, not {values}")
        self._values[values] += amount

    def value(self, *values: str) -> int:
        return self._values[values]

    def lines(self) -> list[str]:
        """The family in text, a sample a line; a family without labels has one from the start."""
        head = [f"# HELP {self.name} {self.help}", f"# TYPE {self.name} {self.kind}"]
        samples: dict[Labels, int] = dict(self._values)
        if not self.labels:
            samples.setdefault((), 0)
        for values in sorted(samples):
            pairs = zip(self.labels, values, strict=True)
            inside = ",".join(f'{label}="{_escape(value)}"' for label, value in pairs)
            head.append(f"{self.name}{f'{{{inside}}}' if inside else ''} {samples[values]}")
        return head


class GaugeFamily(CounterFamily):
    """A named value that rises and falls."""

    kind = "gauge"

    def set(self, amount: int) -> None:
        """Sets the value; for a gauge without labels."""
        self._values[()] = amount


def _escape(value: str) -> str:
    return value.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n")


class Metrics:
    """Everything that /metrics tells."""

    def __init__(self) -> None:
        self.requests = CounterFamily(
            "swings_requests_total", "Responses by route and status code.", "route", "code"
        )
        self.layer_bytes = CounterFamily(
            "swings_layer_bytes_total",
            "Bytes of objects or packets sent, by layer, mask or snapshot, and by how they went.",
            "via",
            "layer",
        )
        self.packets = CounterFamily(
            "swings_play_packets_total",
            "Packets sent by plays, by layer, mask or snapshot.",
            "layer",
        )
        self.plays = CounterFamily(
            "swings_plays_total", "Plays that are over, by how they ended.", "outcome"
        )
        self.play_news = CounterFamily(
            "swings_play_news_total",
            "What clients told of their plays, by what became of it.",
            "outcome",
        )
        self.timeouts = CounterFamily(
            "swings_timeouts_total", "Connections ended because a client took too long.", "kind"
        )
        self.accept_pauses = CounterFamily(
            "swings_accept_pauses_total", "Times that new clients had to wait to be accepted."
        )
        self.active_plays = GaugeFamily("swings_active_plays", "Plays in progress.")
        self.cache_bytes = GaugeFamily("swings_cache_bytes", "Bytes of objects held in memory.")
        self.cache_hits = CounterFamily("swings_cache_hits_total", "Objects found in memory.")
        self.cache_misses = CounterFamily("swings_cache_misses_total", "Objects read from disk.")

    def text(self) -> str:
        """All families in the Prometheus text format."""
        families = [value for value in vars(self).values() if isinstance(value, CounterFamily)]
        return "\n".join(line for family in families for line in family.lines()) + "\n"
