"""The counters and their text."""

from __future__ import annotations

import pytest

from server.state.metrics import CounterFamily, GaugeFamily, Metrics


def test_a_family_is_written_sorted_with_its_labels() -> None:
    family = CounterFamily("things_total", "Things.", "kind", "size")
    family.add(2, "b", "1")
    family.add(1, "a", 'q"\\\n')
    family.add(3, "b", "1")
    assert family.lines() == [
        "# HELP things_total Things.",
        "# TYPE things_total counter",
        'things_total{kind="a",size="q\\"\\\\\\n"} 1',
        'things_total{kind="b",size="1"} 5',
    ]


def test_a_family_without_labels_has_a_value_from_the_start() -> None:
    gauge = GaugeFamily("now", "Now.")
    assert gauge.lines()[-2:] == ["# TYPE now gauge", "now 0"]
    gauge.set(7)
    gauge.set(3)
    assert gauge.lines()[-1] == "now 3"


def test_wrong_labels_are_a_bug() -> None:
    with pytest.raises(ValueError, match="labels"):
        CounterFamily("x", "X.", "a").add(1)


def test_every_family_is_in_the_text() -> None:
    text = Metrics().text()
    assert text.endswith("\n")
    assert text.count("# TYPE ") == 11
    assert "\nswings_active_plays 0\n" in text
