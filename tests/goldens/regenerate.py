"""Writes the goldens anew: `python -m tests.goldens.regenerate` in the root of the project.

Only for a change of the format that is meant and told in FORMAT.md; the version then changes too.
"""

from __future__ import annotations

import json

from tests.goldens import pinned_slots
from tests.goldens.cases import CASES, CODERS, FILE, OBJECTS_FILE, object_record, record
from tests.goldens.rehearsed_streams import FOLDER, write_rehearsed


def main() -> None:
    tables = {
        FILE: [record(c) for c in CASES],
        OBJECTS_FILE: [object_record(c) for c in CODERS],
        pinned_slots.FILE: [pinned_slots.slot_record(c) for c in pinned_slots.SLOT_CASES],
    }
    for file, rows in tables.items():
        file.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    write_rehearsed(FOLDER)


if __name__ == "__main__":
    main()
