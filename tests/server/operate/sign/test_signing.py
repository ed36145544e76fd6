"""Signed paths: signed access is granted, and nothing else."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from codec.errors import InvalidError
from server.operate.sign.signing import ALL, Grant, Reason, Signer, needs_signature
from tests.support.hostile import refused

OLD, NEW = {"old": b"o" * 32}, {"new": b"n" * 32}
SIGNER = Signer(NEW | OLD)
EXPIRY_S = 2_000_000_000
NOW_S = EXPIRY_S - 100.0

names = st.from_regex(r"[A-Za-z0-9][A-Za-z0-9._-]{0,20}", fullmatch=True)


@pytest.mark.parametrize(
    "inner",
    [
        "/v1/streams/walk/manifest.json",
        "/v1/streams/walk/segments/0/1",
        "/v1/streams/walk/play",
        "/v1/streams/walk/my%20poster.png",
        "/v1/streams/walk",
        "/watch/walk",
    ],
)
def test_a_stream_is_granted_with_its_own_path(inner: str) -> None:
    prefix = SIGNER.sign("walk", EXPIRY_S)
    assert SIGNER.verify(prefix + inner, NOW_S) == Grant(inner, "walk", EXPIRY_S)
    assert SIGNER.verify(SIGNER.sign(ALL, EXPIRY_S) + inner, NOW_S) == Grant(
        inner, "walk", EXPIRY_S
    )
    assert SIGNER.verify(inner, NOW_S) is Reason.UNSIGNED
    assert needs_signature(inner)


@pytest.mark.parametrize("inner", ["/", "/v1/streams"])
def test_the_list_of_streams_needs_a_signature_for_all(inner: str) -> None:
    assert SIGNER.verify(SIGNER.sign("walk", EXPIRY_S) + inner, NOW_S) is Reason.SIGNATURE
    granted = SIGNER.verify(SIGNER.sign(ALL, EXPIRY_S) + inner, NOW_S)
    assert granted == Grant(inner, ALL, EXPIRY_S)
    assert needs_signature(inner)


def test_the_players_program_is_found_under_the_same_prefix() -> None:
    path = "/web/player/main.js"
    granted = SIGNER.verify(SIGNER.sign("walk", EXPIRY_S) + path, NOW_S)
    assert granted == Grant(path, "", EXPIRY_S)
    assert not needs_signature(path)
    assert not needs_signature("/healthz")


def test_it_ends_at_its_expiry() -> None:
    path = SIGNER.sign("walk", EXPIRY_S) + "/watch/walk"
    assert isinstance(SIGNER.verify(path, EXPIRY_S - 0.001), Grant)
    assert SIGNER.verify(path, EXPIRY_S) is Reason.EXPIRED
    # For a wrong signature, no client learns its time of expiry.
    assert SIGNER.verify(path.replace("/walk", "/run"), EXPIRY_S) is Reason.SIGNATURE


def test_keys_are_rotated_by_their_names() -> None:
    path = Signer(OLD).sign("walk", EXPIRY_S) + "/watch/walk"
    assert isinstance(SIGNER.verify(path, NOW_S), Grant)
    assert Signer(NEW).verify(path, NOW_S) is Reason.KEY
    assert ".new." in SIGNER.sign("walk", EXPIRY_S)
    assert Signer({"old": b"x" * 32}).verify(path, NOW_S) is Reason.SIGNATURE


@pytest.mark.parametrize(
    "inner",
    [
        "/v1/streams/walk/../run/manifest.json",
        "/v1/streams/walk/%2e%2E/run/manifest.json",
        "/v1/streams/walk/.%2e",
        "/v1/streams/walk/./manifest.json",
        "/web/../v1/streams/run/manifest.json",
    ],
)
def test_a_path_that_leads_elsewhere_is_refused(inner: str) -> None:
    assert SIGNER.verify(SIGNER.sign("walk", EXPIRY_S) + inner, NOW_S) is Reason.UNSIGNED


def test_no_part_of_a_signature_goes_with_another_one() -> None:
    path = SIGNER.sign("walk", EXPIRY_S) + "/watch/walk"
    for other in (
        path.replace(str(EXPIRY_S), str(EXPIRY_S + 1)),
        path.replace(".new.", ".old."),
        path.replace("walk", "run"),
        *(
            path[:n] + c + path[n + 1 :]
            for n in range(len(path))
            for c in "09AZaz-_"
            if path[n] != c
        ),
    ):
        assert isinstance(SIGNER.verify(other, NOW_S), Reason), other


@given(names, names)
def test_another_stream_is_refused(signed: str, asked: str) -> None:
    found = SIGNER.verify(f"{SIGNER.sign(signed, EXPIRY_S)}/watch/{asked}", NOW_S)
    assert isinstance(found, Grant) == (signed == asked)


@given(st.text(max_size=200))
def test_any_text_is_granted_or_refused(text: str) -> None:
    for path in (text, f"/t/{text}", f"{SIGNER.sign('walk', EXPIRY_S)}{text}"):
        found = SIGNER.verify(path, NOW_S)
        if isinstance(found, Grant):
            assert found.stream in ("walk", "")
            assert (found.stream == "") == found.path.startswith("/web/")


def test_what_cannot_be_signed_is_refused() -> None:
    for stream in ("", "a/b", ".hidden", "a b", "ä", "x" * 81, "*x"):
        refused(InvalidError, "name of a stream", SIGNER.sign, stream, EXPIRY_S)
    for expiry_s in (0, -5, 10**12):
        refused(InvalidError, "expiry", SIGNER.sign, "walk", expiry_s)
    refused(InvalidError, "no key", Signer, {})
    refused(InvalidError, "key name", Signer, {"a.b": b"x"})
