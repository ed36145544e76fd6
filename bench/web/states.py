"""Pictures of the browser player in each of its states, on a phone, a laptop and a large screen.

    scripts/bench states FOLDER [--states menu ended] [--screens phone]

Look at them after each change of the controls.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from codec.console import run_command
from codec.errors import InvalidError
from tests.support.web.chromium import running_chromium, why_not
from tests.support.web.playerstates import SCREENS, STATES, Reached, hosting


@dataclass(frozen=True, slots=True)
class StatesConfig:
    """Writes pictures of the browser player in each of its states."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Where the pictures go, STATE-SCREEN.png."""
    states: tuple[str, ...] = tuple(STATES)
    """States to show."""
    screens: tuple[str, ...] = tuple(screen.name for screen in SCREENS)
    """Screens to show them on."""


def run(config: StatesConfig) -> None:
    reason = why_not()
    if reason is not None:
        raise InvalidError(reason)
    config.folder.mkdir(parents=True, exist_ok=True)
    with (
        tempfile.TemporaryDirectory() as streams,
        hosting(Path(streams)) as hosts,
        running_chromium() as page,
    ):
        for state in config.states:
            for screen in SCREENS:
                if screen.name not in config.screens:
                    continue
                STATES[state](Reached(page, hosts, screen))
                page.screenshot(config.folder / f"{state}-{screen.name}.png")
                found = page.axe("swings-player")
                print(f"{state:24} {screen.name:8} {'; '.join(found) or 'accessible'}", flush=True)


if __name__ == "__main__":
    run_command(StatesConfig, run, "scripts/bench states", "Shows the player in each state.")
