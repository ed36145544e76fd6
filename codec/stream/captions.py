"""Captions of a stream: what the manifest says of them, and the WebVTT files beside it.

Rule: pure. A file is read as https://www.w3.org/TR/webvtt1/ says, but without styles, regions and
places: players show the text of the cues that are due, and nothing else.
"""

from __future__ import annotations

import html
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from codec.errors import CorruptError, InvalidError

from .manifestjson import typed

MAX_CAPTIONS = 16
"""Most files of captions of a stream."""

MAX_LABEL_CHARS = 80
MAX_CAPTIONS_BYTES = 1 << 20
"""Largest file of captions."""

MAX_CUES = 1 << 16
CAPTIONS_TYPE = "text/vtt; charset=utf-8"

LANGUAGE = "[A-Za-z0-9]{1,8}(?:-[A-Za-z0-9]{1,8}){0,3}"
"""Regular expression of a language, as BCP 47 writes them."""

_TIME = r"(?:(\d{2,6}):)?([0-5]\d):([0-5]\d)\.(\d{3})"
_TIMING = re.compile(rf"[ \t]*{_TIME}[ \t]*-->[ \t]*{_TIME}(?:[ \t].*)?", re.ASCII)
_TAG = re.compile(r"<[^>]*>?")
_LONG_REFERENCE = re.compile(r"&#([0-9]{8,})")


@dataclass(frozen=True, slots=True)
class Captions:
    """Captions in one language. Raises InvalidError when a value breaks a rule."""

    language: str
    """As BCP 47 writes it, such as en or pt-BR."""
    label: str
    """Name that viewers choose, such as English."""

    def __post_init__(self) -> None:
        if re.fullmatch(LANGUAGE, self.language) is None:
            raise InvalidError(
                f"manifest: captions have the language {self.language[:40]!a}; name one such as "
                "en or pt-BR"
            )
        if not 1 <= len(self.label) <= MAX_LABEL_CHARS or not self.label.isprintable():
            raise InvalidError(
                f"manifest: captions {self.language} have a label that is not 1 to "
                f"{MAX_LABEL_CHARS} printable characters"
            )

    @property
    def file_name(self) -> str:
        """The file beside the manifest."""
        return f"captions-{self.language}.vtt"

    def is_in(self, language: str) -> bool:
        """Whether they are in `language`; upper and lower case are the same."""
        return self.language.lower() == language.lower()

    def to_json(self) -> dict[str, Any]:
        return {"language": self.language, "label": self.label}


def check_captions(captions: Sequence[Captions]) -> None:
    """Raises InvalidError for too many captions, or two of one language."""
    if len(captions) > MAX_CAPTIONS:
        raise InvalidError(f"manifest: {len(captions)} captions, at most {MAX_CAPTIONS}")
    if len({each.language.lower() for each in captions}) != len(captions):
        raise InvalidError("manifest: two captions have the same language")


def captions_of(value: Mapping[str, Any]) -> tuple[Captions, ...]:
    """The captions in the JSON of a manifest. Raises CorruptError or InvalidError."""
    found = typed({"captions": [], **value}, "captions", list)
    if len(found) > MAX_CAPTIONS or not all(type(each) is dict for each in found):
        raise CorruptError(f"manifest: captions are not at most {MAX_CAPTIONS} objects")
    return tuple(
        Captions(typed(each, "language", str), typed(each, "label", str)) for each in found
    )


@dataclass(frozen=True, slots=True)
class Cue:
    """A text and when it shows: from `start_s` on, before `end_s`, in seconds from frame 0."""

    start_s: float
    end_s: float
    text: str
    """Lines, without tags."""


def parse_webvtt(data: bytes) -> tuple[Cue, ...]:
    """The cues of a WebVTT file, in their order. Blocks that are none are passed over, as the
    specification says. Raises CorruptError if it is no such file, or too large."""
    if len(data) > MAX_CAPTIONS_BYTES:
        raise CorruptError(f"captions: {len(data)} bytes, at most {MAX_CAPTIONS_BYTES}")
    text = data.decode("utf-8", "replace").removeprefix("\ufeff").replace("\0", "\ufffd")
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    if re.fullmatch(r"WEBVTT(?:[ \t].*)?", lines[0]) is None:
        raise CorruptError("captions: this is not WebVTT; the first line is WEBVTT", 0)
    cues: list[Cue] = []
    at = 1
    while at < len(lines):
        found = _TIMING.fullmatch(lines[at])
        at += 1
        if found is None:
            continue
        begin = at
        while at < len(lines) and lines[at] and "-->" not in lines[at]:
            at += 1
        start_s, end_s = _seconds(found.groups()[:4]), _seconds(found.groups()[4:])
        said = _unescaped(_TAG.sub("", "\n".join(lines[begin:at]))).strip()
        if start_s < end_s and said:
            cues.append(Cue(start_s, end_s, said))
    if len(cues) > MAX_CUES:
        raise CorruptError(f"captions: {len(cues)} cues, at most {MAX_CUES}")
    return tuple(cues)


def _seconds(parts: Sequence[str | None]) -> float:
    hours, minutes, seconds, thousandths = (int(part or 0) for part in parts)
    return 3600 * hours + 60 * minutes + seconds + thousandths / 1000


def _unescaped(text: str) -> str:
    # Python's int refuses thousands of digits. Eight that count are as wrong as more of them.
    short = _LONG_REFERENCE.sub(lambda found: f"&#{found[1].lstrip('0')[:8] or 0}", text)
    return html.unescape(short)
