"""Runs the code of player/web in Node, so that tests can compare it with the package."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields

from codec.errors import CodecError, CorruptError, UnsupportedError
from codec.slots.slotlayout import SlotLayout
from tests.support.slots.arrivals import Arrivals, Change, Event, Keyframe, Look, Show, SkipMap
from tests.support.slots.plain import Held
from tests.support.web.nodeprocess import Json, NodeProcess, running_script


def in_browser(value: object) -> object:
    """`value` in the form of answers.mjs."""
    match value:
        case bytes():
            return value.hex()
        case tuple():
            return [in_browser(one) for one in value]
        case str():
            return value[:500]  # of a message it keeps no more
    return value


def fields_in_browser(one: object, names: Iterable[str]) -> dict[str, object]:
    """The attributes `names` of `one`, as answers.mjs names them: numGs for num_gs."""
    return {
        re.sub("_(.)", lambda found: found[1].upper(), name): in_browser(getattr(one, name))
        for name in names
    }


class BrowserCode:
    """Sends questions to answers.mjs."""

    def __init__(self, node: NodeProcess) -> None:
        self._node = node

    def ask(self, kind: str, **question: object) -> Json:
        """The answer. Raises the CodecError that matches the browser's error."""
        answer = self._node.answer(kind, question)
        if "refused" in answer:
            errors = {"corrupt": CorruptError, "unsupported": UnsupportedError}
            raise errors[answer["refused"]](answer["message"])
        return answer["value"]

    def takes(self, kind: str, **question: object) -> bool:
        try:
            self.ask(kind, **question)
        except CodecError:
            return False
        return True


@contextmanager
def running_code() -> Iterator[BrowserCode]:
    with running_script("answers.mjs") as node:
        yield BrowserCode(node)


class BrowserSlots:
    """The slot decoder of player/web/format, with the calls of `SlotDecoder`."""

    def __init__(
        self,
        browser: BrowserCode,
        layout: SlotLayout,
        num_layers: int | None = None,
    ) -> None:
        self._browser = browser
        self._edges = layout.row_edges
        self.moves: list[int] = []
        """Moves of the rows that the last slice changed; see `movesOf`."""
        browser.ask(
            "layout",
            swinSize=layout.swin_size,
            segmentFrames=layout.segment_frames,
            shDegree=layout.sh_degree,
            slots=layout.slots,
            lattices=[
                fields_in_browser(lattice, [field.name for field in fields(lattice)])
                for lattice in layout.lattices
            ],
            numLayers=num_layers,
        )

    def load(self, keyframe: bytes) -> bool:
        used: bool = self._browser.ask("load", bytes=keyframe.hex())
        return used

    def apply(
        self, birth: int, skip_map: bytes | None, changes: Sequence[bytes | None]
    ) -> list[int]:
        """The rows of the lane that changed, counted over all layers."""
        found = self._browser.ask(
            "apply",
            birth=birth,
            skipMap=None if skip_map is None else skip_map.hex(),
            changes=[None if change is None else change.hex() for change in changes],
        )
        layers = zip(found["moves"], found["rows"], strict=False)
        self.moves = [move for moves, rows in layers for move in moves or [0] * len(rows)]
        pairs = zip(found["rows"], self._edges, strict=False)
        return [edge + row for rows, edge in pairs for row in rows]

    def late(self, birth: int, layer: int, change: bytes) -> bool:
        used: bool = self._browser.ask("late", birth=birth, layer=layer, bytes=change.hex())
        return used

    def held(self) -> Held:
        """The state, in the form of tests.support.slots.plain.held."""
        return _held(self._browser.ask("held"))

    def played(self, arrivals: Arrivals) -> list[Held]:
        """The state of a play of player/web at each Look of `arrivals`."""
        events = [_event(event, arrivals.join_frame) for event in arrivals.events]
        return [_held(lanes) for lanes in self._browser.ask("arrivals", events=events)]


def _held(lanes: Json) -> Held:
    def one(slot: Json) -> object:
        if isinstance(slot, str):
            return slot
        start, integers, bits = slot
        return start, None if integers is None else tuple(integers), bytes.fromhex(bits)

    return [[[one(slot) for slot in layer] for layer in lane] for lane in lanes]


def _event(event: Event, join_frame: int) -> list[object]:
    match event:
        case SkipMap(birth, chunk):
            return ["skip_map", birth, None, chunk.hex()]
        case Change(birth, layer, chunk):
            return ["change", birth, layer, chunk.hex()]
        case Keyframe(frame, layer, chunk):
            return ["keyframe", frame, layer, chunk.hex()]
        case Show(frame):
            return ["join" if frame == join_frame else "show", frame]
        case Look():
            return ["look"]
