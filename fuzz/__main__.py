"""Runs libFuzzer on the parsers; see fuzz/codec.py."""

from __future__ import annotations

import logging
import os
import sys
import warnings

import atheris


def main() -> None:
    os.environ["NUMBA_DISABLE_JIT"] = "1"
    with atheris.instrument_imports(include=["codec"]):
        from .codec import accepts

    def test_one_input(data: bytes) -> None:
        accepts(data)

    # As in the tests: a numpy warning about an overflow means that the code did not expect it.
    warnings.simplefilter("error")
    logging.disable()
    atheris.Setup(sys.argv, test_one_input)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
