"""The text of /metrics, parsed by prometheus-client."""

from __future__ import annotations

import re

import yaml  # type: ignore[import-untyped]
from prometheus_client.parser import text_string_to_metric_families

from server.operate.prometheus import Metrics
from tests.support.commands import ROOT

FAMILIES = {
    "swings_requests",
    "swings_layer_bytes",
    "swings_play_packets",
    "swings_plays",
    "swings_play_status_reports",
    "swings_active_plays",
    "swings_cache_bytes",
    "swings_cache_hits",
    "swings_cache_misses",
    "swings_ttfb_seconds",
    "swings_open_connections",
    "swings_refused",
    "swings_timeouts",
    "swings_shed_layers",
    "swings_loop_late_seconds",
    "swings_log_dropped",
    "swings_worker_requests",
    "swings_streams",
}


def test_every_family_is_in_the_text() -> None:
    text = Metrics().text()
    assert {family.name for family in text_string_to_metric_families(text)} == FAMILIES
    assert "_created" not in text


def test_alerts_go_by_series_that_are_there() -> None:
    text = (ROOT / "deploy" / "prometheus-rules.yaml").read_text()
    for rule in yaml.safe_load(text)["groups"][0]["rules"]:
        names = re.findall(r"\bswings_[a-z_]+", rule["expr"])
        assert names
        assert {re.sub(r"_(total|bucket)$", "", name) for name in names} <= FAMILIES, rule
