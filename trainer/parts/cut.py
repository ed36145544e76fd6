"""Where a capture is cut."""

from __future__ import annotations

from dataclasses import dataclass

from codec.errors import InvalidError


@dataclass(frozen=True, slots=True)
class Part:
    """Frames that one worker trains, whole segments but for the last."""

    number: int
    first_frame: int
    end_frame: int


def cut(num_frames: int, part_frames: int, segment_frames: int, seam_frames: int) -> list[Part]:
    """The parts of a stream, of about `part_frames` each.

    Each has more frames than the seam at its beginning, so the last one may be longer. Raises
    InvalidError where parts would be shorter than that.
    """
    if part_frames <= seam_frames:
        raise InvalidError(
            f"part_frames {part_frames}: choose more than the {seam_frames} frames of a seam"
        )
    whole = -(-part_frames // segment_frames) * segment_frames
    firsts = list(range(0, num_frames, whole))
    if len(firsts) > 1 and num_frames - firsts[-1] <= seam_frames:
        firsts.pop()
    ends = [*firsts[1:], num_frames]
    return [Part(n, first, end) for n, (first, end) in enumerate(zip(firsts, ends, strict=True))]
