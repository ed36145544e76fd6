"""The best of all plays that decide on whole groups, found exactly: for small cases.

Each group of frames has a number of layers, and its slices are sent whole, in order, as early as
they may be; a frame shows when its slice is there. That is how a stream is played that knows
nothing of layers coming apart, so this is what layers sent apart are measured by.

Two plays that show the same from here on are one if one of them is as early and worth as much,
or more.
"""

from __future__ import annotations

from dataclasses import dataclass

from codec.errors import InvalidError

from ..link.link import Link
from ..media import Media
from ..qoe import QoeConfig
from ..session import SessionConfig
from .feasible import Play, open_play
from .groups import GROUP_S, Grouping, group_frames
from .wholelayers import Look, SliceLooks, SlotLooks

MOST_LABELS = 5_000
"""Plays that differ, up to the end of one group."""


@dataclass(frozen=True, slots=True)
class Plan:
    """The best play."""

    quality_db: float
    num_layers: tuple[int, ...]
    """Of each group."""


@dataclass(frozen=True, slots=True)
class _Label:
    """A play up to the end of a group."""

    quality_db: float
    """What the frames so far add to that of the play, without waiting."""
    sent_bytes: float
    """That the link has passed, idle or not, when the last slice has."""
    shown_s: tuple[float, ...]
    """Of the frames that later ones wait for; none before the play begins."""
    look: Look
    stretch_db: tuple[float, ...]
    """PSNR of the frames of the open stretch."""
    before_db: float | None
    """Mean PSNR of the stretch before it."""
    num_layers: tuple[int, ...]

    @property
    def key(self) -> tuple[object, ...]:
        return self.look, self.stretch_db, self.before_db

    def beats(self, other: _Label) -> bool:
        """Whether this is as good or better, if both have one key."""
        return (
            self.quality_db >= other.quality_db
            and self.sent_bytes <= other.sent_bytes
            and all(a <= b for a, b in zip(self.shown_s, other.shown_s, strict=True))
        )


def best_plan(
    media: Media,
    link: Link,
    session_config: SessionConfig,
    qoe_config: QoeConfig,
    first_frame: int,
    until_frame: int,
    group_s: float = GROUP_S,
) -> Plan:
    """Raises InvalidError as `bound` does, and where there are too many plays to tell apart."""
    play = open_play(media, link, session_config, first_frame, until_frame)
    programme = _Programme(play, qoe_config, group_frames(play, qoe_config, group_s))
    labels = [programme.begin()]
    for number in range(len(programme.grouping.groups)):
        labels = programme.step(labels, number)
    return max((programme.plan(label) for label in labels), key=lambda plan: plan.quality_db)


class _Programme:
    def __init__(self, play: Play, config: QoeConfig, grouping: Grouping) -> None:
        self.play, self.config, self.grouping = play, config, grouping
        self.looks = SlotLooks(play) if play.media.has_slots else SliceLooks(play)

    def begin(self) -> _Label:
        return _Label(0.0, 0.0, (), self.looks.begin(), (), None, ())

    def step(self, labels: list[_Label], number: int) -> list[_Label]:
        """All plays with one more group that none of the others beats."""
        kept: dict[tuple[object, ...], list[_Label]] = {}
        count = 0
        for label in labels:
            for num_layers in range(1, self.play.media.num_layers + 1):
                new = self._advance(label, number, num_layers)
                if new is None:
                    continue
                same = kept.setdefault(new.key, [])
                if any(old.beats(new) for old in same):
                    continue
                count += 1 - sum(new.beats(old) for old in same)
                same[:] = [old for old in same if not new.beats(old)] + [new]
                if count > MOST_LABELS:
                    raise InvalidError(
                        f"more than {MOST_LABELS} different plays; use a shorter play"
                    )
        return [label for same in kept.values() for label in same]

    def _advance(self, label: _Label, number: int, num_layers: int) -> _Label | None:
        """`label` with another group of `num_layers`; None where they cannot be had."""
        play, group = self.play, self.grouping.groups[number]
        found = self.looks.advance(label.look, group, num_layers)
        if found is None:
            return None
        slices_bytes, psnr_db, look = found
        sent_bytes, shown_s = label.sent_bytes, list(label.shown_s)
        first = group.first_frame - play.first_frame
        dropped = max(0, first - play.lead_frames) if shown_s else 0  # frames before shown_s
        for frame, num_bytes in enumerate(slices_bytes, first):
            if frame >= play.lead_frames:
                waits_s = shown_s[frame - play.lead_frames - dropped]
                sent_bytes = max(sent_bytes, play.passage.bytes_by(waits_s))
            sent_bytes += num_bytes
            comes_s = play.passage.comes_s(play.passage.earliest_s(sent_bytes))
            if shown_s:
                shown_s.append(max(shown_s[-1] + play.frame_s, comes_s))
            elif frame + 1 == play.start_frames:
                shown_s = [comes_s + k * play.frame_s for k in range(frame + 1)]
        after = group.end_frame - play.first_frame
        shown_s = shown_s[max(0, after - play.lead_frames) - dropped :]
        quality_db = label.quality_db + sum(psnr_db) / play.num_frames
        stretch_db, before_db = (*label.stretch_db, *psnr_db), label.before_db
        if group.stretch is None:
            stretch_db = ()
        elif len(stretch_db) == self.grouping.stretch_frames:
            mean_db = sum(stretch_db) / len(stretch_db)
            if before_db is not None:
                steps = self.grouping.num_stretches - 1
                quality_db -= self.config.switch_db * abs(mean_db - before_db) / steps
            stretch_db, before_db = (), mean_db
        return _Label(
            quality_db,
            sent_bytes,
            tuple(shown_s),
            look,
            stretch_db,
            before_db,
            (*label.num_layers, num_layers),
        )

    def plan(self, label: _Label) -> Plan:
        """Of a play to the end."""
        play = self.play
        waited_s = label.shown_s[-1] - (play.num_frames - 1) * play.frame_s
        cost_db = self.config.stall_db * waited_s / (play.num_frames * play.frame_s)
        return Plan(label.quality_db - cost_db, label.num_layers)
