"""Traces: both formats are read correctly, and any bytes give a link or one clear line."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Sequence
from itertools import accumulate

import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from server.abr.link import Link, LinkStep
from server.abr.traces import MAX_TRACE_BYTES, parse_trace, scaled
from tests.support.hostile import flips, truncations

gaps_ms = st.lists(st.one_of(st.just(0), st.integers(0, 30), st.integers(0, 5000)), min_size=1)
times_ms = gaps_ms.map(lambda gaps: list(accumulate(gaps))).filter(lambda times: times[-1] > 0)


def text_of(times_ms: Sequence[int], newline: str = "\n") -> bytes:
    return "".join(f"{time_ms}{newline}" for time_ms in times_ms).encode()


@given(
    st.lists(
        st.tuples(st.floats(1, 1e5), st.floats(1, 1e7) | st.integers(1, 10**7), st.floats(0, 1e3)),
        min_size=1,
    )
)
def test_json_steps(values: list[tuple[float, float, float]]) -> None:
    keys = ("duration_ms", "bandwidth_kbps", "latency_ms")
    data = json.dumps([dict(zip(keys, step, strict=True)) for step in values]).encode()
    assert parse_trace(data, "t").steps == tuple(
        LinkStep(duration_ms / 1000, rate_kbps * 1000, latency_ms / 1000)
        for duration_ms, rate_kbps, latency_ms in values
    )


@given(times_ms, st.sampled_from(["\n", "\r\n"]), st.floats(0, 1))
def test_each_line_lets_1504_bytes_pass(
    times_ms: list[int], newline: str, latency_s: float
) -> None:
    link = parse_trace(text_of(times_ms, newline), "t", latency_s)
    assert link.round_s == pytest.approx(times_ms[-1] / 1000)
    assert link.mean_bps == pytest.approx(len(times_ms) * 1504 * 8000 / times_ms[-1])
    assert {step.latency_s for step in link.steps} == {latency_s}
    # At the end of each step, as many packets have passed as there are lines up to then.
    for end_s in accumulate(step.duration_s for step in link.steps):
        lines = sum(time_ms <= round(end_s * 1000) for time_ms in times_ms)
        assert link.capacity_bytes(0, end_s - 1e-9) == pytest.approx(lines * 1504, rel=1e-5)


def test_a_trace_of_mahimahi() -> None:
    # 12 Mbit/s, as in its manual, for a quarter of a second; nothing for a second; one packet.
    link = parse_trace(text_of([*range(1, 251), 1250]), "t", 0.03)
    mtu_bits = 1504 * 8
    assert link.steps == (
        LinkStep(0.1, 100 * mtu_bits / 0.1, 0.03),
        LinkStep(0.1, 100 * mtu_bits / 0.1, 0.03),
        LinkStep(0.1, 50 * mtu_bits / 0.1, 0.03),
        LinkStep(0.9, 0.0, 0.03),
        LinkStep(0.05, mtu_bits / 0.05, 0.03),
    )
    assert parse_trace(b"5", "t").steps == (LinkStep(0.005, mtu_bits / 0.005, 0.0),)
    assert parse_trace(b"0\n0\n5\n\n", "t").steps == (LinkStep(0.005, 3 * mtu_bits / 0.005, 0.0),)


@given(times_ms, st.floats(0.2, 100), st.floats(0, 20))
def test_a_trace_of_scaled_rates(times_ms: list[int], factor: float, at_s: float) -> None:
    link = parse_trace(text_of(times_ms), "t", 0.03)
    other = scaled(link, factor)
    assert other.round_s == link.round_s
    assert other.mean_bps == pytest.approx(factor * link.mean_bps)
    assert other.at(at_s).latency_s == 0.03
    capacity = link.capacity_bytes(0, at_s)
    assert other.capacity_bytes(0, at_s) == pytest.approx(factor * capacity, abs=1e-3)


@pytest.mark.parametrize("factor", [0.0, -1.0, math.nan, math.inf])
def test_factors_that_scale_nothing(factor: float) -> None:
    with pytest.raises(InvalidError, match="give a number over 0"):
        scaled(Link([LinkStep(1, 8e3, 0)]), factor)


STEP = b'[{"duration_ms": %b, "bandwidth_kbps": %b, "latency_ms": %b}]'


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "the file is not JSON nor lines of milliseconds"),
        (b"[", "the file is not JSON nor lines of milliseconds"),
        (b"[" * 100_000, "the file is not JSON"),
        (b"\xff\xfe\x00", "the file is not JSON"),
        (b"[" + b"1" * 5000 + b"]", "the file is not JSON"),
        (b"-5\n", "the file is not a list of steps"),
        (b"{}", "the file is not a list of steps"),
        (b"[5]", "step 0 must have the numbers duration_ms, bandwidth_kbps, latency_ms"),
        (b'[{"duration_ms": 5}]', "step 0 must have"),
        (STEP % (b"true", b"5", b"5"), "step 0 must have"),
        (STEP % (b"0", b"5", b"5"), "link: step 0 is"),
        (STEP % (b"5", b"NaN", b"5"), "link: step 0 is"),
        (STEP % (b"5", b"1" * 400, b"5"), "step 0: bandwidth_kbps is too large"),
        (b"0\n0\n", "the last line is 0 ms"),
        (b"5\n3\n", "line 2 is 3 ms, after 5 ms"),
        (b"5\n\n7\n", "line 2 is '', not a whole number"),
        (b"5.5\n7\n", r"line 1 is '5\.5', not a whole number"),
        (b"1_0\n", "line 1 is '1_0', not"),
        (b"5 6\n", "line 1 is '5 6', not"),
        (b"5\n\xd9\xa3\n", "line 2 is"),
        (b"5\n" + b"9" * 9999, "line 2 is '99999999999999999999', not"),
    ],
)  # fmt: skip
def test_bad_traces(data: bytes, message: str) -> None:
    with pytest.raises(InvalidError, match=f"^trace some name: .*{message}") as error:
        parse_trace(data, "some name")
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 300


def test_a_trace_that_is_too_large() -> None:
    with pytest.raises(InvalidError, match="trace t: the file has more than 64 MiB"):
        parse_trace(bytes(MAX_TRACE_BYTES + 1), "t")


def answers(link: Link) -> None:
    assert link.passed_s(1.5, 1e6) > 1.5
    assert link.at(1.5) in link.steps


def survives(data: bytes) -> None:
    with contextlib.suppress(InvalidError):
        answers(parse_trace(data, "t"))


def test_altered_traces_give_a_link_or_an_error() -> None:
    for data in (STEP % (b"500", b"2.5e3", b"20"), text_of([3, 70, 70, 250, 1250])):
        for altered in (*truncations(data), *flips(data)):
            survives(altered)
