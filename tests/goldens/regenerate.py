"""Writes the golden chunks anew: `python -m tests.goldens.regenerate` in the root of the project.

Only for a change of the format that is meant and told in FORMAT.md; the version then changes too.
"""

from __future__ import annotations

import json

from tests.goldens.cases import CASES, FILE, record


def main() -> None:
    FILE.write_text(json.dumps([record(case) for case in CASES], indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
