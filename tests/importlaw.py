"""The law of imports, as data.

tests/test_packaging.py checks the code against it. docs/architecture.py draws it, and writes the
tables of docs/ARCHITECTURE.md; after a change here run scripts/architecture.
"""

from __future__ import annotations

PACKAGES = ("trainer", "codec", "server", "player")
"""The packages, in the order of the data flow."""

MAY_USE: dict[str, tuple[str, ...]] = {
    # Comparisons with a capture are written by the same code as plays.
    "trainer": (
        "codec",
        "player.render",
        "player.show.sink",
        "player.view.path",
    ),
    "codec": (),
    "server": ("codec",),
    "server/abr": ("codec.errors", "codec.stream.segment", "codec.stream.manifest"),
    "player": ("codec", "server.abr"),
    "player/render": ("codec",),
}
"""The modules and packages that each folder may import, besides itself. A folder obeys its own row
and those of the folders around it."""

FLOORS: dict[str, tuple[tuple[str, ...], ...]] = {
    "trainer": (
        ("trainer", "trainer/lease"),
        ("trainer/capture",),
        ("trainer/pictures", "trainer/seed", "trainer/synth"),
        ("trainer/step", "trainer/rig"),
        ("trainer/step/device",),
        ("trainer/calibrate", "trainer/fit", "trainer/score"),
        ("trainer/run",),
        ("trainer/parts",),
    ),
    "codec": (
        ("codec",),
        ("codec/coders", "codec/lattice", "codec/storage"),
        ("codec/slots",),
        ("codec/stream",),
        ("codec/foreign", "codec/tracks"),
        ("codec/interop", "codec/edit"),
        ("codec/sequence",),
        ("codec/tools",),
    ),
    "server": (
        ("server/abr",),
        ("server/study", "server/operate/sign"),
        (
            "server/html",
            "server/library",
            "server/operate",
        ),
        ("server/http",),
        ("server/state",),
        ("server/answers",),
        ("server",),
    ),
    "player": (
        ("player/network", "player/render", "player/view", "player/link"),
        ("player/source",),
        ("player/render/gl", "player/playout"),
        ("player/sound",),
        ("player/show",),
        ("player",),
        ("player/report", "player/script"),
        ("player/run",),
    ),
}
"""The folders of each package on floors, from the ground up: a folder imports only from lower
floors. The package's name stands for its own files."""
