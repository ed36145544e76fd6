"""Deferred signals: the first waits until the block ends, a second one does not."""

from __future__ import annotations

import signal

import pytest

from codec.interrupts import postponed_interrupts


@pytest.mark.parametrize("times", [1, 2])
def test_the_first_signal_waits_and_the_second_does_not(times: int) -> None:
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    done: list[int] = []

    def interrupted() -> None:
        with postponed_interrupts():
            for number in range(times):
                signal.raise_signal(signal.SIGTERM)
                done.append(number)

    try:
        with pytest.raises(KeyboardInterrupt):
            interrupted()
        assert done == [0]
        assert signal.getsignal(signal.SIGTERM) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGTERM, before)


def test_an_ignored_signal_stays_ignored() -> None:
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with postponed_interrupts():
            signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_signal_is_not_lost_to_an_error_of_the_block() -> None:
    def failing() -> None:
        with postponed_interrupts():
            signal.raise_signal(signal.SIGINT)
            raise OSError("no space")

    with pytest.raises(KeyboardInterrupt):
        failing()
