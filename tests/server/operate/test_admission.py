"""Limits per address and in all."""

from __future__ import annotations

import subprocess
import sys
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from server.operate.admission import Admission, AdmissionConfig, Refusal
from server.operate.clientaddress import parse_proxies
from tests.support.commands import ROOT


def test_one_address_cannot_take_all_places() -> None:
    admission = Admission(max_all=5, max_address=3)
    assert [admission.admit("192.0.2.1") for _ in range(4)] == [None] * 3 + [Refusal.ADDRESS]
    assert admission.admit("192.0.2.2") is None
    assert admission.admit("192.0.2.3") is None
    assert admission.admit("192.0.2.4") is Refusal.FULL
    admission.release("192.0.2.1")
    assert admission.admit("192.0.2.4") is None


def test_a_whole_ipv6_network_is_one_address() -> None:
    admission = Admission(max_all=100, max_address=2)
    assert admission.admit("2001:db8:0:1::1") is None
    assert admission.admit("2001:db8:0:1:ffff::2") is None
    assert admission.admit("2001:db8:0:1:5::3") is Refusal.ADDRESS
    assert admission.admit("2001:db8:0:2::1") is None
    # The same machine, however the kernel writes it.
    assert admission.admit("::ffff:192.0.2.1") is None
    assert admission.admit("192.0.2.1") is None
    assert admission.admit("192.0.2.1") is Refusal.ADDRESS


def test_a_trusted_proxy_counts_in_all_only() -> None:
    admission = Admission(5, 1, parse_proxies("10.0.0.0/8"))
    assert [admission.admit("10.1.2.3") for _ in range(6)] == [None] * 5 + [Refusal.FULL]
    assert admission.num_addresses == 0
    admission.release("10.1.2.3")
    assert admission.admit("192.0.2.1") is None


def test_giving_back_what_nobody_holds_is_a_bug() -> None:
    admission = Admission(5, 5)
    with pytest.raises(ValueError, match="holds nothing"):
        admission.release("192.0.2.1")
    admission.admit("192.0.2.2")
    with pytest.raises(ValueError, match="holds nothing"):
        admission.release("192.0.2.1")


addresses = st.sampled_from(["192.0.2.1", "192.0.2.2", "2001:db8::1", "10.0.0.1", ""])


@given(st.lists(st.tuples(st.booleans(), addresses), max_size=200))
def test_it_counts_as_a_simple_model_does(events: list[tuple[bool, str]]) -> None:
    admission = Admission(8, 3, parse_proxies("10.0.0.0/8"))
    model: Counter[str] = Counter()
    for comes, address in events:
        if comes:
            exempt = address in ("10.0.0.1", "")
            full = model.total() >= 8
            refused = full or (not exempt and model[address] >= 3)
            assert (admission.admit(address) is not None) == refused
            model[address] += not refused
        elif model[address]:
            admission.release(address)
            model[address] -= 1
        assert admission.num_held == model.total()
        holding = {a for a, n in model.items() if n and a not in ("10.0.0.1", "")}
        assert admission.num_addresses == len(holding)


def test_limits_below_one_are_refused() -> None:
    with pytest.raises(InvalidError, match="max_address_plays"):
        AdmissionConfig(max_address_plays=0)


def limited(soft: int, hard: int, wanted: int) -> subprocess.CompletedProcess[str]:
    """What a process with these limits of open files finds."""
    code = (
        "import resource\n"
        f"resource.setrlimit(resource.RLIMIT_NOFILE, ({soft}, {hard}))\n"
        "from codec.errors import SwingsError\n"
        "from server.operate.descriptors import RESERVE, connection_limit\n"
        "try:\n"
        f"    print(connection_limit({wanted}), resource.getrlimit(resource.RLIMIT_NOFILE)[0])\n"
        "except SwingsError as error:\n"
        "    print(error)\n"
    )
    return subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )


def test_connections_stay_below_the_limit_of_open_files() -> None:
    limit, soft = map(int, limited(100, 512, 4096).stdout.split())
    assert soft == 512  # it was raised as far as it may
    assert 512 - 64 - 20 < limit < 512 - 64
    assert limited(100, 512, 7).stdout.split()[0] == "7"


def test_no_room_for_connections_is_one_clear_line() -> None:
    line = limited(64, 64, 4096).stdout
    assert "the limit of open files is 64" in line
    assert "ulimit -n" in line
