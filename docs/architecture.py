"""Writes docs/architecture.svg and the tables of docs/ARCHITECTURE.md from tests/importlaw.py.

Given folders, it prints what each of their files is for.

Run by scripts/architecture.
"""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path

from tests.importlaw import FLOORS, MAY_USE, PACKAGES

DOCS = Path(__file__).parent
PICTURE = DOCS / "architecture.svg"
PAGE = DOCS / "ARCHITECTURE.md"
BEGIN = "<!-- Written by scripts/architecture from tests/importlaw.py. -->"
END = "<!-- End of what scripts/architecture writes. -->"

ROOM_PX, TITLE_PX, FLOOR_PX, PAD_PX = 340, 42, 34, 12
TOP_PX, GAP_PX = 20, 120
LEFT_X, RIGHT_X = 140, 600
WIDTH_PX = 1080

COLOURS = {
    "trainer": ("#2a5ea8", "#e8f0fb", "#8ab4f0", "#16243a"),
    "codec": ("#1f7a57", "#e6f4ee", "#7fd0ae", "#142b22"),
    "server": ("#a85a16", "#fdf0e0", "#f0b070", "#33230f"),
    "player": ("#7a3d99", "#f5eafa", "#d3a0ec", "#2a1a34"),
}
"""Ink and paper of each room, in light and in dark."""


def room_height(package: str) -> int:
    return TITLE_PX + FLOOR_PX * len(FLOORS[package]) + PAD_PX


MIDDLE_Y = TOP_PX + max(room_height("trainer"), room_height("codec"))
BELOW_Y = MIDDLE_Y + GAP_PX
HEIGHT_PX = BELOW_Y + max(room_height("server"), room_height("player")) + TOP_PX

# Data goes clockwise, from the frames at the top left to the picture at the bottom left.
CORNERS = {
    "trainer": (LEFT_X, TOP_PX),
    "codec": (RIGHT_X, TOP_PX),
    "server": (RIGHT_X, BELOW_Y),
    "player": (LEFT_X, BELOW_Y),
}
INNER_X = LEFT_X + ROOM_PX
OUTER_X = RIGHT_X + ROOM_PX
IMPORT_Y = 150
"""Height of an import's arrow in a room, below its top."""
DATA_Y = 70

# For each pair of packages of which one may import the other: the arrow's ends, and where its first
# line of text begins.
IMPORTS = {
    ("trainer", "codec"): (
        (INNER_X, TOP_PX + IMPORT_Y, RIGHT_X, TOP_PX + IMPORT_Y),
        (INNER_X + 14, TOP_PX + IMPORT_Y - 8),
    ),
    ("trainer", "player"): (
        (LEFT_X + 90, MIDDLE_Y, LEFT_X + 90, BELOW_Y),
        (LEFT_X + 102, MIDDLE_Y + 34),
    ),
    ("server", "codec"): (
        (RIGHT_X + 170, BELOW_Y, RIGHT_X + 170, MIDDLE_Y),
        (RIGHT_X + 182, MIDDLE_Y + 64),
    ),
    ("player", "codec"): (
        (INNER_X, BELOW_Y, RIGHT_X, MIDDLE_Y),
        (INNER_X + 72, MIDDLE_Y + 64),
    ),
    ("player", "server"): (
        (INNER_X, BELOW_Y + IMPORT_Y, RIGHT_X, BELOW_Y + IMPORT_Y),
        (INNER_X + 14, BELOW_Y + IMPORT_Y - 8),
    ),
}


def style() -> str:
    light: list[str] = []
    dark: list[str] = []
    for package, (ink, paper, dark_ink, dark_paper) in COLOURS.items():
        for rules, line, fill in ((light, ink, paper), (dark, dark_ink, dark_paper)):
            rules.append(f".{package} .room {{ fill: {fill}; stroke: {line} }}")
            rules.append(f".{package} .box {{ stroke: {line} }}")
            rules.append(f".{package} .title {{ fill: {line} }}")
    return "\n".join(
        [
            "<style>",
            "text { font: 13px Helvetica, Arial, sans-serif; fill: #222 }",
            ".title { font-size: 18px; font-weight: bold }",
            ".name { text-anchor: middle }",
            ".note { font-size: 12px; fill: #555 }",
            ".ground { fill: #fff }",
            ".box { fill: #fff }",
            ".thing { fill: #f2f2f2; stroke: #777 }",
            ".data { fill: none; stroke: #444; stroke-width: 3 }",
            ".import { fill: none; stroke: #777; stroke-width: 1.5; stroke-dasharray: 5 4 }",
            ".data-head { fill: #444 }",
            ".import-head { fill: #777 }",
            *light,
            "@media (prefers-color-scheme: dark) {",
            "text { fill: #e6e6e6 }",
            ".note { fill: #b0b0b0 }",
            ".ground { fill: #0d1117 }",
            ".box { fill: #0d1117 }",
            ".thing { fill: #20262e; stroke: #999 }",
            ".data { stroke: #ccc }",
            ".import { stroke: #999 }",
            ".data-head { fill: #ccc }",
            ".import-head { fill: #999 }",
            *dark,
            "}",
            "</style>",
        ]
    )


def text(x: float, y: float, words: str, kind: str) -> str:
    return f'<text class="{kind}" x="{x:g}" y="{y:g}">{words}</text>'


def rectangle(x: float, y: float, width: float, height: float, kind: str) -> str:
    return (
        f'<rect class="{kind}" x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="6"/>'
    )


def room(package: str) -> str:
    """A package, with the folders of its ground floor at the bottom."""
    x, y = CORNERS[package]
    height = room_height(package)
    parts = [
        f'<g class="{package}">',
        rectangle(x, y, ROOM_PX, height, "room"),
        text(x + PAD_PX, y + 27, package, "title"),
    ]
    inside = ROOM_PX - 2 * PAD_PX
    for floor, folders in enumerate(FLOORS[package]):
        top = y + height - PAD_PX - FLOOR_PX * (floor + 1) + 3
        step = (inside + 4) / len(folders)
        for n, folder in enumerate(folders):
            left = x + PAD_PX + n * step
            name = folder.removeprefix(f"{package}/") if folder != package else "own files"
            parts.append(rectangle(left, top, step - 4, FLOOR_PX - 6, "box"))
            parts.append(text(left + (step - 4) / 2, top + 19, name, "name"))
    return "\n".join([*parts, "</g>"])


def thing(x: float, y: float, height: float, name: str, *notes: str) -> str:
    """A box for something that is not code: a recording, files, a picture."""
    parts = [rectangle(x, y, 94, height, "thing"), text(x + 47, y + 22, name, "name")]
    parts += [text(x + 8, y + 42 + 16 * n, note, "note") for n, note in enumerate(notes)]
    return "\n".join(parts)


def arrow(path: str, kind: str) -> str:
    return f'<path class="{kind}" d="{path}" marker-end="url(#{kind})"/>'


def imports() -> list[str]:
    found: dict[tuple[str, str], list[str]] = {}
    for package in PACKAGES:
        for module in MAY_USE[package]:
            found.setdefault((package, module.split(".")[0]), []).append(module)
    parts = []
    for pair, modules in found.items():
        (x0, y0, x1, y1), (x, y) = IMPORTS[pair]
        parts.append(arrow(f"M{x0} {y0} L{x1} {y1}", "import"))
        parts += [text(x, y + 16 * n, module, "note") for n, module in enumerate(modules)]
    return parts


def picture() -> str:
    data_y, play_y = TOP_PX + DATA_Y, BELOW_Y + DATA_Y
    stream_x, stream_y = OUTER_X + 30, MIDDLE_Y + 6
    legend_y = BELOW_Y + room_height("player") + 40
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH_PX} {HEIGHT_PX}">',
        "<title>The packages of swings, and how the data passes them</title>",
        style(),
        "<defs>",
        *(
            f'<marker id="{kind}" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="{px}" '
            f'markerHeight="{px}" markerUnits="userSpaceOnUse" orient="auto">'
            f'<path class="{kind}-head" d="M0 0 L10 5 L0 10 z"/></marker>'
            for kind, px in (("data", 14), ("import", 10))
        ),
        "</defs>",
        f'<rect class="ground" width="{WIDTH_PX}" height="{HEIGHT_PX}"/>',
        *map(room, PACKAGES),
        thing(10, data_y - 40, 80, "capture", "frames,", "cameras"),
        thing(stream_x, stream_y, 108, "stream", "manifest.json", "index.bin", "segments/"),
        thing(10, play_y - 40, 80, "picture", "window, video,", "browser"),
        arrow(f"M104 {data_y} H{LEFT_X}", "data"),
        arrow(f"M{INNER_X} {data_y} H{RIGHT_X}", "data"),
        text(INNER_X + 14, data_y - 10, "slices", "note"),
        arrow(f"M{OUTER_X} {data_y} H{stream_x + 47} V{stream_y}", "data"),
        arrow(f"M{stream_x + 47} {stream_y + 108} V{play_y} H{OUTER_X}", "data"),
        arrow(f"M{RIGHT_X} {play_y} H{INNER_X}", "data"),
        text(INNER_X + 14, play_y - 10, "packets", "note"),
        arrow(f"M{LEFT_X} {play_y} H104", "data"),
        *imports(),
        arrow(f"M{LEFT_X} {legend_y - 4} h40", "data"),
        text(LEFT_X + 52, legend_y, "data flow", "note"),
        arrow(f"M{LEFT_X} {legend_y + 22} h40", "import"),
        text(LEFT_X + 52, legend_y + 26, "import, only of what the label names", "note"),
        text(LEFT_X, legend_y + 52, "Within a package, a folder imports only", "note"),
        text(LEFT_X, legend_y + 68, "from the floors below its own.", "note"),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def tables() -> str:
    lines = ["| folder | may import of the other packages |", "|---|---|"]
    for folder, modules in MAY_USE.items():
        lines.append(f"| `{folder}` | {', '.join(f'`{m}`' for m in modules) or 'nothing'} |")
    lines += ["", "| package | folders, from the ground floor up |", "|---|---|"]
    for package in PACKAGES:
        floors = [", ".join(shown(package, folder) for folder in row) for row in FLOORS[package]]
        lines.append(f"| `{package}` | {'; '.join(floors)} |")
    return "\n".join(lines) + "\n"


def shown(package: str, folder: str) -> str:
    return "its own files" if folder == package else f"`{folder.removeprefix(f'{package}/')}`"


def page(old: str) -> str:
    """The text of ARCHITECTURE.md with the tables as the law has them now."""
    before, rest = old.split(BEGIN)
    _, after = rest.split(END)
    return f"{before}{BEGIN}\n\n{tables()}\n{END}{after}"


def opening(file: Path) -> str:
    """The purpose of a file: the first paragraph of its docstring or, in JavaScript, of the comment
    that it opens with, or else of that of its first exported class or function."""
    words = file.read_text(encoding="utf-8")
    if file.suffix == ".py":
        said = ast.get_docstring(ast.parse(words)) or ""
    else:
        said = ""
        for found in re.finditer(r"/\*\*((?:[^*]|\*(?!/))*)\*/\n(.*)", words):
            is_head = found.start() == 0 and not found[2].startswith("const ")
            if is_head or re.match("export (?!const)", found[2]):
                said = re.sub(r"(?m)^\s*\* ?", "", found[1]).strip()
                said = re.split(r"(?:^|\s)@\w", said)[0]
            if said:
                break
    return " ".join(said.split("\n\n")[0].split())


def print_files(folder: Path) -> None:
    files = [f for f in sorted(folder.rglob("*")) if f.suffix in {".py", ".js"}]
    for file in files:
        path = file.relative_to(folder)
        if file.name == "__init__.py" or {"node_modules", "bundle", "test"} & set(path.parts):
            continue
        sys.stdout.write(f"{path.as_posix():<28} {opening(file)}\n")


def main() -> None:
    if sys.argv[1:]:
        for folder in sys.argv[1:]:
            print_files(Path(folder))
        return
    PICTURE.write_text(picture(), encoding="utf-8")
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
