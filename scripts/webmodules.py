"""Writes the module of player/web that repeats constants of Python; a test compares them.

Run by scripts/webmodules.
"""

from __future__ import annotations

import dataclasses
import json
import struct
import tomllib
from enum import Enum, EnumType
from pathlib import Path
from types import ModuleType
from typing import Any

from codec import camera, slice, splats
from codec.coders import planes, zstd
from codec.lattice import forms, lattice
from codec.slots import change, changepacket, decoder, rangecoder, skipmap, slotlayout, state
from codec.stream import (
    captions,
    integrity,
    manifest,
    packedlayout,
    pictures,
    playrecord,
    poster,
    reader,
    segment,
    sound,
)
from player.render import project, upload

ROOT = Path(__file__).parents[1]
WEB = ROOT / "player" / "web"

CONSTANTS: dict[ModuleType, str] = {
    project: "LOW_PASS_PX2 JACOBIAN_CLAMP ALPHA_MAX ALPHA_MIN MAX_EXTENT_SIGMA SH_C1 "
    "SH_C2 SH_C3 COLOUR_TURN_RAD",
    upload: "COLOUR_COLUMNS MOVES ENTERS LEAST_SPARE SPARE_SHARE",
    splats: "SH_C0 MAX_SH_DEGREE",
    slice: "MAX_SWIN_SIZE HIDDEN JUMP_SIGMAS",
    camera: "MAX_IMAGE_PX",
    manifest: "VERSION MAX_MANIFEST_BYTES MAX_CAMERAS MIN_FPS MAX_FPS MAX_TEXT_CHARS "
    "MAX_POSTER_BYTES",
    reader: "DEFAULT_MAX_GAUSSIANS FLOAT_COPIES",
    slotlayout: "MAX_SLOTS MAX_NUM_GS=MAX_SLOTS_OF_LANES MAX_SEGMENT_SLOTS MAX_LAYERS "
    "MAX_SEGMENT_FRAMES MAX_CHUNK_BYTES=MAX_SLOT_CHUNK_BYTES COUNTS_BYTES "
    "CHUNK_MAGIC=SLOT_MAGIC CHUNK_HEAD=SLOT_HEADER CHUNK_KINDS=Kind "
    "HAS_STARTS=FLAG_SLOT_OFFSETS KEPT ENDED PREDICTED NEW",
    lattice: "POSITION_LIMIT MIN_STEP MAX_STEP MAX_BASE",
    forms: "MAX_OPACITY_LEVELS MAX_LOGIT",
    change: "CHANGE_COUNTS=COUNTS LONG MAX_GAP_BITS=MAX_LENGTH",
    skipmap: "CONTEXTS FIRST_OF_B CONTEXT_OF_C",
    rangecoder: "WHOLE_RANGE=WHOLE LEAST_RANGE=LEAST FIRST_PROBABILITY MOST_COUNTED",
    state: "UNKNOWN EMPTY ON_LATTICE ESCAPED",
    decoder: "MIN_LOG_BYTES LOG_SHARE",
    segment: "CODER SKIPPABLE_MAGIC TABLE_MAGIC OBJECT_HEAD OBJECT_ENTRY=ENTRY "
    "MAX_CHUNKS=MAX_CHUNKS_PER_OBJECT MAX_OBJECT_BYTES INDEX_HEAD=HEAD "
    "INDEX_LAYER=LAYER INDEX_SIDE=SIDE INDEX_CHECKSUM=CHECKSUM",
    zstd: "ZSTD_MAGIC=MAGIC MAX_EXPANSION",
    planes: "NUM_CODES MOST_ONES MOST_LOW_BITS LENGTH_BITS MOST_LENGTH CODE_BITS CENTRE_BITS",
    changepacket: "CODED=FORM CODED_HEAD=HEAD SH_DEGREE_BITS",
    integrity: "MAX_INDEX_BYTES",
    captions: "MAX_CAPTIONS MAX_CAPTIONS_BYTES",
    pictures: "MAX_PICTURE_BYTES",
    packedlayout: "ZIP_LOCAL=LOCAL ZIP_LOCAL_MAGIC=LOCAL_MAGIC PACKED_SUFFIX "
    "PACKED_EXTRA=EXTRA PACKED_EXTRA_ID=EXTRA_ID PACKED_VERSION=LAYOUT_VERSION "
    "FIRST_PACKED_BYTES=FIRST_BYTES",
    playrecord: "PACKETS_KEY MAX_RECORD_BYTES MAX_MESSAGE_CHARS MAX_KEYS MAX_ITEMS MAX_TEXT_BYTES",
    sound: "SAMPLE_RATE PREROLL MAX_SOURCES MAX_SOUND_KEYS=MAX_KEYS MAX_PACKETS "
    "MAX_SOUND_BYTES MAX_POSITION MAX_PACKET_SAMPLES SOUND_PREFIX "
    "SOUND_MAGIC=MAGIC SOUND_HEAD=HEAD",
    poster: "MAX_STORYBOARD_TILES=MAX_TILES STORYBOARD_COLUMNS=COLUMNS "
    "STORYBOARD_PER_S=TILES_PER_S",
}
"""Constants that the browser needs, by module; NAME=OTHER: OTHER is the name in the module."""

MOST_COLUMNS = 100
"""Maximum length of a line of JavaScript."""

RECORDS = {
    "start": playrecord.StartRecord,
    "slice": playrecord.SliceRecord,
    "keyframe": playrecord.KeyframeRecord,
    "end": playrecord.EndRecord,
    "error": playrecord.ErrorRecord,
}
"""The records of a play by their kind."""

TYPES = {
    "int": "number",
    "str": "string",
    "bytes": "Uint8Array",
    "bytes | None": "Uint8Array | null",
    "tuple[bytes, ...]": "Uint8Array[]",
}


def value(found: Any) -> str:
    """A constant in JavaScript: a Struct becomes its format, an enum an object with its numbers,
    bytes a string if they are ASCII, else an array."""
    if isinstance(found, struct.Struct):
        return json.dumps(found.format)
    if isinstance(found, bytes):
        return json.dumps(found.decode("ascii") if found.isascii() else list(found))
    if isinstance(found, EnumType):
        members: list[Enum] = list(found)
        return "{ " + ", ".join(f"{one.name}: {one.value}" for one in members) + " }"
    if isinstance(found, float):
        return f"{found:.17g}" if found.is_integer() else repr(found).replace("e-0", "e-")
    return json.dumps(found)


def constants() -> str:
    """The module of shared constants: numbers, layouts and the shapes of play records."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lines = ["/** Written by scripts/webmodules from the package's own constants. */"]
    version = value(project["version"])
    lines += ["", "// pyproject.toml", f"export const PLAYER_VERSION = {version};"]
    for module, names in CONSTANTS.items():
        lines += ["", f"// {module.__name__}"]
        for name in names.split():
            ours, _, theirs = name.partition("=")
            text = value(getattr(module, theirs or ours))
            line = f"export const {ours} = {text};"
            if len(line) > MOST_COLUMNS and text.startswith("["):  # breaks it like prettier
                line = f"export const {ours} = [\n  {text[1:-1]},\n];"
            lines.append(line)
    lines += ["", "/**", f" * {playrecord.__name__}"]
    for kind, record in RECORDS.items():
        fields = "".join(
            f", {camel(field.name)}: {TYPES[str(field.type)]}"
            for field in dataclasses.fields(record)
        )
        lines.append(f' * @typedef {{{{ kind: "{kind}"{fields} }}}} {record.__name__}')
    union = " | ".join(record.__name__ for record in RECORDS.values())
    return "\n".join([*lines, f" * @typedef {{{union}}} PlayRecord", " */"]) + "\n"


def camel(name: str) -> str:
    first, *rest = name.split("_")
    return first + "".join(map(str.capitalize, rest))


def modules() -> dict[Path, str]:
    """The text of each generated file."""
    return {WEB / "constants.js": constants()}


def main() -> None:
    for path, text in modules().items():
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
