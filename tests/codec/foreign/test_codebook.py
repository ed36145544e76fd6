"""Codebooks and palettes: their content, their errors, and that they are deterministic."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codec.foreign.codebook import CODES, codebook, codes_of, palette
from codec.splats import Floats


def drawn(seed: int, count: int, dims: int) -> Floats:
    return np.random.default_rng(seed).normal(size=(count, dims)).astype(np.float32)


@given(st.lists(st.floats(-1e6, 1e6, width=32), max_size=CODES))
def test_what_has_few_values_is_kept_exactly(values: list[float]) -> None:
    given = np.array(values, np.float32)
    book = codebook(given)
    assert book.shape == (CODES,)
    assert (np.diff(book) >= 0).all()
    assert (book[codes_of(given, book)] == given).all()


@pytest.mark.parametrize("shape", ["even", "bell", "far"])
def test_many_values_are_near_theirs(shape: str) -> None:
    rng = np.random.default_rng(5)
    values = rng.normal(size=30_000).astype(np.float32)
    if shape == "even":
        values = rng.uniform(-1, 1, 30_000).astype(np.float32)
    if shape == "far":
        values[:5] = [90, 91, 95, -80, -80]
    book = codebook(values)
    assert (book == codebook(values)).all()
    codes = codes_of(values, book)
    away = np.abs(book[codes] - values)
    # Each value has the nearest entry.
    assert (away <= np.abs(values[:, None] - book).min(axis=1) + 1e-6).all()
    even = np.ptp(values) / CODES
    assert away.max() < 1.2 * even  # half of the initial book is in even steps
    if shape == "bell":
        # The least that any book of a normal distribution can reach (Panter and Dite, 1951).
        least = np.sqrt(np.sqrt(3) * np.pi / 2) / CODES
        assert np.sqrt((away**2).mean()) < 1.1 * least


def test_a_palette_of_all_rows_is_exact_and_alike_rows_share() -> None:
    rows = drawn(3, 50, 9)[np.arange(200) % 50]
    entries, labels = palette(rows, 64)
    assert entries.shape == (50, 9)
    assert (entries[labels] == rows).all()
    # Labels are numbered by their first row.
    assert (labels[:50] == np.arange(50)).all()


@given(st.integers(0, 300), st.integers(1, 12), st.integers(1, 64))
@settings(max_examples=40, deadline=None)
def test_a_palette_is_the_means_of_its_groups(count: int, dims: int, size: int) -> None:
    rows = drawn(count, count, dims)
    entries, labels = palette(rows, size)
    assert len(entries) <= size
    assert sorted(set(labels.tolist())) == list(range(len(entries)))
    for number, entry in enumerate(entries):
        assert entry == pytest.approx(
            rows[labels == number].astype(np.float64).mean(axis=0), abs=1e-6
        )


def test_a_palette_finds_groups_that_there_are() -> None:
    centres = 10 * drawn(8, 30, 9)
    group = np.random.default_rng(1).integers(0, 30, 3000)
    rows = centres[group] + 0.01 * drawn(9, 3000, 9)
    entries, labels = palette(rows, 64)
    assert np.abs(entries[labels] - rows).max() < 0.1
