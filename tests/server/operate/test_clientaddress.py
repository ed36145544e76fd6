"""The address of a client, independent of forged headers."""

from __future__ import annotations

from ipaddress import ip_network

import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from server.operate.admission import client_address, parse_address, parse_proxies

PROXIES = parse_proxies("10.0.0.0/8, ::1,2001:db8:5::/48")


@pytest.mark.parametrize(
    ("peer", "lines", "client"),
    [
        ("192.0.2.7", ["198.51.100.1"], "192.0.2.7"),  # headers of an untrusted peer are ignored
        ("10.1.2.3", [], "10.1.2.3"),
        ("10.1.2.3", ["198.51.100.1"], "198.51.100.1"),
        ("10.1.2.3", ["203.0.113.9, 198.51.100.1"], "198.51.100.1"),  # forged on the left
        ("10.1.2.3", ["203.0.113.9", "198.51.100.1, 10.9.9.9"], "198.51.100.1"),
        ("10.1.2.3", ["10.4.4.4, 10.9.9.9"], "10.4.4.4"),
        ("10.1.2.3", ["198.51.100.1:4711"], "198.51.100.1"),
        ("10.1.2.3", ["[2001:db8::7]:4711"], "2001:db8::7"),
        ("::1", ["2001:DB8:0::7%eth0"], "2001:db8::7"),
        ("::ffff:10.1.2.3", ["::ffff:198.51.100.1"], "198.51.100.1"),
        ("10.1.2.3", ["198.51.100.1, unknown"], "10.1.2.3"),
        ("10.1.2.3", ["198.51.100.1, 10.9.9.9, <script>, 10.8.8.8"], "10.8.8.8"),
        ("10.1.2.3", [""], "10.1.2.3"),
        ("10.1.2.3", ["198.51.100.1", ","], "10.1.2.3"),
        ("", ["198.51.100.1"], ""),
        ("unix:", ["198.51.100.1"], "unix:"),
        ("::ffff:192.0.2.7", [], "192.0.2.7"),
    ],
)
def test_the_last_one_that_is_not_a_trusted_proxy_is_the_client(
    peer: str, lines: list[str], client: str
) -> None:
    assert client_address(peer, lines, PROXIES) == client
    own = peer.removeprefix("::ffff:")
    assert client_address(peer, lines, ()) == own  # if no proxy is trusted


def test_a_long_header_is_read_from_the_right_and_not_to_its_end() -> None:
    line = ", ".join(["198.51.100.1", *["10.9.9.9"] * 5000])
    assert client_address("10.1.2.3", [line], PROXIES) == "10.9.9.9"


@given(st.lists(st.text(max_size=50), max_size=5), st.ip_addresses(network="198.51.100.0/24"))
def test_what_stands_left_of_the_client_changes_nothing(forged: list[str], client: object) -> None:
    assert client_address("10.1.2.3", [*forged, str(client)], PROXIES) == str(client)


@given(st.text(max_size=80))
def test_any_text_is_an_address_or_none(text: str) -> None:
    parse_address(text)
    assert client_address("10.1.2.3", [text], PROXIES)


def test_proxies_are_networks_between_commas() -> None:
    assert parse_proxies("") == ()
    assert parse_proxies(" 10.0.0.0/8 ,,::1") == (ip_network("10.0.0.0/8"), ip_network("::1"))
    for wrong in ("10.0.0.1/8", "proxy", "10.0.0.0/33", "10.0.0.0/8 ::1"):
        with pytest.raises(InvalidError, match="trusted proxy"):
            parse_proxies(wrong)
