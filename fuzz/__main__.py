"""Runs libFuzzer over the parsers, or with `http` as its first word over the server; fuzz/codec.py
and fuzz/http.py say how."""

from __future__ import annotations

import logging
import os
import sys
import warnings

import atheris


def main() -> None:
    if sys.argv[1:2] == ["http"]:
        del sys.argv[1]
        with atheris.instrument_imports(include=["server"]):
            from .http import test_one_input
    else:
        os.environ["NUMBA_DISABLE_JIT"] = "1"
        with atheris.instrument_imports(include=["codec"]):
            from .codec import accepts

        def test_one_input(data: bytes) -> None:
            accepts(data)

    # As in the tests: an overflow that numpy warns of is one that the code did not expect.
    warnings.simplefilter("error")
    logging.disable()
    atheris.Setup(sys.argv, test_one_input)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
