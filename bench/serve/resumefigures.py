"""Effect of killed workers on clients, from the records of `resumeload`. No clock.

Definitions of the figures:

* victim: a client whose play ran in the worker when it was killed; the others are bystanders.
* resume: time from the kill to the first new slice of the victim's next play. It includes the time
  until the client notices, which is immediate, and its wait before a new attempt, 0.1 s at first.
* layers before, after: mean number of layers that had arrived by the end, of the NEAR slices before
  the first slice of the victim's next play, and of the NEAR slices from it on. lost: before minus
  after, by victim.
* gap: time between two reads that bring layer 0 to a bystander, for reads that end in the AFTER_S
  seconds after a kill. A returning client is sent a whole lead in addition to its buffer, and then
  nothing until that lead has been shown, so a client's buffer beyond `max_lead_s` at the beginning
  of a gap does not count. usual: the same in the second before the kill.
* missing: births between a client's first and last for which layer 0 never arrived.
  double: repeated packets of the same slice and layer.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .playfigures import Spread
from .resumeload import FIRST_FRAMES

NEAR = 30

AFTER_S = 1.0


@dataclass(frozen=True, slots=True)
class Kill:
    """A worker that was killed."""

    at_s: float
    place: int
    """Number of the worker; the tokens of its plays begin with it."""
    restart_s: float = np.nan
    """When its replacement accepted connections, on the clock of `at_s`; NaN if unknown."""


@dataclass(frozen=True, slots=True)
class ResumeFigures:
    """Figures of all clients and kills together; times in ms."""

    clients: int
    kills: int
    victims: int
    bystanders: int
    restart_ms: Spread
    """Time from each kill until the replacement accepts connections."""
    resume_ms: Spread
    """Over all victims that resumed before the next kill."""
    lost: int
    """Victims that did not resume before the next kill."""
    broken: int
    """Bystanders whose play was replaced by another within AFTER_S seconds after a kill."""
    gap_ms: Spread
    usual_ms: Spread
    before: float
    """Mean layers of slices before a break."""
    after: float
    lost_layers: Spread
    """Over all victims."""
    missing: int
    double: int
    stalls: int
    refused: int
    """Connections that were not accepted."""
    answered: dict[str, int]
    """Number of responses to plays by HTTP status, other than 200."""
    said: dict[str, int]
    """Number of responses that ended with an error record, by its message."""
    reports: dict[str, int]
    """Number of status reports by HTTP status; 0 for no answer."""
    slowest_report_ms: float


def resume_figures(path: Path, kills: list[Kill], fps: float, max_lead_s: float) -> ResumeFigures:
    """The figures of the file at `path`. max_lead_s: the server's maximum lead."""
    with np.load(path) as seen:
        packets = {key: seen[key] for key in ("who", "birth", "at_s", "first", "layers")}
        plays = {key: seen[key] for key in ("play_s", "play_who", "play_place", "play_birth")}
        known: dict[str, Any] = json.loads(str(seen["known"]))
    clients = [_Seen(packets, plays, n) for n in range(int(plays["play_who"].max()) + 1)]
    resume_s, before, after = list[float](), list[float](), list[float]()
    gaps, usual = list[float](), list[float]()
    lost = broken = bystanders = victims = 0
    for n, kill in enumerate(kills):
        end_s = kills[n + 1].at_s if n + 1 < len(kills) else np.inf
        for number, one in enumerate(clients):
            if known["over_s"].get(str(number), np.inf) < kill.at_s:
                continue  # a returning client is sent an extra lead, and so ends early
            last = int(np.searchsorted(one.play_s, kill.at_s)) - 1
            if last < 0:
                continue
            next_s = one.play_s[last + 1] if last + 1 < len(one.play_s) else np.inf
            if one.place[last] != kill.place:
                bystanders += 1
                broken += bool(next_s < kill.at_s + AFTER_S)
                gaps += one.gaps(kill.at_s, fps, max_lead_s)
                usual += one.gaps(kill.at_s - AFTER_S, fps, max_lead_s)
                continue
            victims += 1
            arrived_s = one.base_s[one.base_s >= next_s]
            if not len(arrived_s) or arrived_s[0] >= end_s:
                lost += 1
                continue
            resume_s.append(float(arrived_s[0]) - kill.at_s)
            birth = int(one.birth[last + 1])
            before.append(one.mean_layers(birth - NEAR, birth))
            after.append(one.mean_layers(birth, birth + NEAR))
    return ResumeFigures(
        clients=len(clients),
        kills=len(kills),
        victims=victims,
        bystanders=bystanders,
        restart_ms=_ms([one.restart_s - one.at_s for one in kills]),
        resume_ms=_ms(resume_s),
        lost=lost,
        broken=broken,
        gap_ms=_ms(gaps),
        usual_ms=_ms(usual),
        before=float(np.mean(before)) if before else np.nan,
        after=float(np.mean(after)) if after else np.nan,
        lost_layers=Spread.of(np.array(before) - np.array(after)),
        missing=sum(one.missing for one in clients),
        double=sum(one.double for one in clients),
        stalls=known["stalls"],
        refused=known["refused"],
        answered=known["answered"],
        said=known["said"],
        reports=known["reports"],
        slowest_report_ms=1e3 * known["slowest_report_s"],
    )


def _ms(values: list[float]) -> Spread:
    return Spread.of(1e3 * np.array(values))


class _Seen:
    """The packets and plays of one client."""

    def __init__(
        self, packets: dict[str, NDArray[Any]], plays: dict[str, NDArray[Any]], number: int
    ) -> None:
        own = plays["play_who"] == number
        self.play_s, self.place = plays["play_s"][own], plays["play_place"][own]
        self.birth = plays["play_birth"][own]
        mine = packets["who"] == number
        births, first = packets["birth"][mine], packets["first"][mine]
        ends = first + packets["layers"][mine]
        base = first == 0
        self.base_s, self._base_births = packets["at_s"][mine][base], births[base]
        ahead = np.flatnonzero(births[base] + 1 >= FIRST_FRAMES)
        self._began_s = float(self.base_s[ahead[0]]) if len(ahead) else np.nan  # to show
        self._least = int(births.min(initial=0))
        num_births = int(births.max(initial=0)) + 1 - self._least
        self._layers = np.zeros(num_births, int)
        np.maximum.at(self._layers, births - self._least, ends)
        self.missing = int(num_births - len(np.unique(births[base])))
        # Without repetition a slice has as many packets as layers.
        counts = np.zeros(num_births, int)
        np.add.at(counts, births - self._least, ends - first)
        self.double = int(np.maximum(0, counts - self._layers).sum())

    def gaps(self, from_s: float, fps: float, max_lead_s: float) -> list[float]:
        """The gaps, in seconds, that end within AFTER_S seconds after `from_s`."""
        ends_s = self.base_s[1:]
        inside = np.flatnonzero((ends_s > from_s) & (ends_s <= from_s + AFTER_S))
        shown = fps * (self.base_s[inside] - self._began_s)
        spare_s = (self._base_births[inside] - shown) / fps - max_lead_s
        gaps_s = ends_s[inside] - self.base_s[inside]
        return list((gaps_s - np.maximum(0, spare_s))[gaps_s > 0])

    def mean_layers(self, first: int, end: int) -> float:
        """Mean over the slices born at first .. end - 1, as far as they exist; NaN if none does."""
        part = self._layers[max(0, first - self._least) : max(0, end - self._least)]
        return float(part.mean()) if len(part) else np.nan
