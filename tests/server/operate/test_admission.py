"""Limits per address and in total."""

from __future__ import annotations

import subprocess
import sys
from collections import Counter

from hypothesis import example, given
from hypothesis import strategies as st

from server.operate.admission import Admission, Refusal, parse_proxies
from tests.support.commands import ROOT
from tests.support.hostile import refused


def test_giving_back_what_nobody_holds_is_a_bug() -> None:
    admission = Admission(5, 5)
    refused(ValueError, "holds nothing", admission.release, "192.0.2.1")
    admission.admit("192.0.2.2")
    refused(ValueError, "holds nothing", admission.release, "192.0.2.1")


COUNTED_AS = {
    "192.0.2.1": "192.0.2.1",
    "::ffff:192.0.2.1": "192.0.2.1",  # the same machine, in another notation of the kernel
    "192.0.2.2": "192.0.2.2",
    "2001:db8:0:1::1": "2001:db8:0:1::/64",  # a whole network is one address
    "2001:db8:0:1:ffff::2": "2001:db8:0:1::/64",
    "2001:db8:0:2::1": "2001:db8:0:2::/64",
    "10.0.0.1": "",  # a trusted proxy counts only in total
    "": "",
}


TO_THE_LIMITS = [
    *[(True, "192.0.2.1")] * 4,
    *[(True, "2001:db8:0:1::1"), (True, "2001:db8:0:1:ffff::2")] * 2,
    *[(True, "10.0.0.1")] * 3,
    (False, "192.0.2.1"),
    (True, "192.0.2.2"),
]


@example(TO_THE_LIMITS)
@given(st.lists(st.tuples(st.booleans(), st.sampled_from(sorted(COUNTED_AS))), max_size=200))
def test_it_counts_as_a_simple_model_does(events: list[tuple[bool, str]]) -> None:
    admission = Admission(8, 3, parse_proxies("10.0.0.0/8"))
    model: Counter[str] = Counter()
    for comes, address in events:
        key = COUNTED_AS[address]
        if comes:
            expected = Refusal.ADDRESS if key and model[key] >= 3 else None
            expected = Refusal.FULL if model.total() >= 8 else expected
            assert admission.admit(address) is expected
            model[key] += expected is None
        elif model[key]:
            admission.release(address)
            model[key] -= 1
        assert admission.num_held == model.total()
        assert len(admission._held) == len(+model - Counter({"": model[""]}))


def limited(soft: int, hard: int, wanted: int) -> subprocess.CompletedProcess[str]:
    """Runs a process with these limits of open files, which prints its actual limits."""
    code = (
        "import resource\n"
        f"resource.setrlimit(resource.RLIMIT_NOFILE, ({soft}, {hard}))\n"
        "from codec.errors import SwingsError\n"
        "from server.operate.admission import RESERVE, connection_limit\n"
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
    assert soft == 512  # raised as far as allowed
    assert 512 - 64 - 20 < limit < 512 - 64
    assert limited(100, 512, 7).stdout.split()[0] == "7"


def test_no_room_for_connections_is_one_clear_line() -> None:
    line = limited(64, 64, 4096).stdout
    assert "the limit of open files is 64" in line
    assert "ulimit -n" in line
