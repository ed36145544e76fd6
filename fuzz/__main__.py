"""Runs libFuzzer over the parsers; fuzz/codec.py says how."""

from __future__ import annotations

import logging
import sys
import warnings

import atheris

with atheris.instrument_imports(include=["codec"]):
    from .codec import accepts


def test_one_input(data: bytes) -> None:
    accepts(data)


def main() -> None:
    # As in the tests: an overflow that numpy warns of is one that the code did not expect.
    warnings.simplefilter("error")
    logging.disable()
    atheris.Setup(sys.argv, test_one_input)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
